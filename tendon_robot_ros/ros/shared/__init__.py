"""
What the nodes share.

messages.py            ROS messages to arrays and back; their frames (TF); quality of service
parameters.py          declared parameters with range and unit; those of another node
overrides.py           settings that a node was started with and does not know
lifecycle.py           nodes that start by themselves; their status
inbox.py               subscriptions of any kind; what a thread of its own hears; the topic `stop`
joints.py              joint messages from their bytes
senders.py             who published a message; of several, whose messages count
transport.py           how nodes reach each other
runtime.py             running nodes so that they end safe; nodes as processes
robot_client.py        who speaks to a running robot: waits, sends targets, reads statuses
running_arm.py         the running robot as an investigation asks it
stopping.py            every node that can be stopped, found and stopped
files.py               files that come with the package
"""
