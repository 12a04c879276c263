"""A robot that runs, as a source of stamped messages: a log played back, topics of ROS 2 over DDS or zenoh.

`arrival` says what a source is; `playback`, `dds` and `zenoh_topics` are three. `signals` takes the signals of a column
map from its messages, as the reader of logs does, and `stamps` puts them in the order of their stamps.
"""
