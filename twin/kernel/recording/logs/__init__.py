"""Logs of real robots and curves of other tools, as series in SI units with the product's names.

`reader.read_log` reads a log of any kind into a `log.Log`; `column_map` maps columns to signals and units.
"""
