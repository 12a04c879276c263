"""Logs of real robots and curves of other tools, as series in SI units with the product's names.

`reader.read_log` reads a recording of twin, any MCAP file, a bag of ROS 2 or a CSV file into a `log.Log`. `column_map`
maps columns to signals and units.
"""
