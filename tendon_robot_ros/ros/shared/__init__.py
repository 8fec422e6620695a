"""
What the nodes share.

messages.py            ROS messages to arrays and back; quality of service of every topic
tf_frames.py           frames of incoming messages, through TF where it is there
parameters.py          declared parameters with range and unit; those of another node
lifecycle.py           nodes that start by themselves; their status
inbox.py               subscriptions of any kind; what a thread of its own hears; the topic `stop`
origin.py              who published a message
senders.py             several publishers of a topic: whose messages count, who the others are
runtime.py             running nodes so that they end safe; nodes as processes
robot_client.py        who speaks to a running robot: waits, sends targets, reads statuses
running_arm.py         the running robot as an investigation asks it
files.py               files that come with the package
"""
