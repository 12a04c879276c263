"""Logs of a real robot and curves from elsewhere, as series in SI units under the product's own names.

`reader.read_log` is the door: it takes a recording of twin, an MCAP file of anyone's or a CSV file. `column_map` says
which column is which signal, `units` what a unit means, `sampling` where samples are missing. What comes out is a
`log.Log`.
"""
