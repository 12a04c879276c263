"""Sources of a robot's stamped messages: a log played back, or ROS 2 topics over DDS or zenoh.

`arrival` defines a source; `playback`, `dds` and `zenoh_topics` implement it. `signals` reads the signals of a column
map from messages, as the reader of logs does, and `stamps` aligns them by their stamps.
"""
