"""
Recordings of ROS 2 (rosbag2), without ROS (docs/data_sets.md).

reader.py           what a recording holds about measurements, and about moving
senders.py          two senders of a topic, and a clock that was set back
transforms.py       markers that came as transforms, and frames that are not the base
writer.py           recordings and their messages, written
still_segments.py   where the arm stands still: the segments that count as measurements
importing.py        a recording to a data set, with a picture of what was taken
exporting.py        a data set to a recording
"""
