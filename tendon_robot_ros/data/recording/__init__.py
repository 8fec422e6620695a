"""
Recordings of ROS 2 (rosbag2), without ROS (docs/data_sets.md).

reader.py           what a recording holds about measurements, and in which frame; two senders
still_segments.py   where the arm stands still: the segments that count as measurements
importing.py        a recording to a data set, with a picture of what was taken
writer.py           messages to a recording, and a data set to one
"""
