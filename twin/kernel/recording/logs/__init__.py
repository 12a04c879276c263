"""Logs of a real robot and curves from elsewhere, as series in SI units under the product's own names.

`reader.read_log` is the door: it takes a recording of twin, an MCAP file of anyone's, a bag of ROS 2 or a CSV file.
`column_map` says which column is which signal and in which unit. What comes out is a `log.Log`.
"""
