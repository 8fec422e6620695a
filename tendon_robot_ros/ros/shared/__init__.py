"""
What the nodes share.

messages.py            ROS messages to arrays and back; their frames (TF); quality of service
timing.py              times that several nodes share, each with its reason
parameters.py          declared parameters with range and unit; those of another node
lifecycle.py           nodes that start by themselves and can be stopped; their status
inbox.py               what a thread of its own hears: subscriptions, services, the topic `stop`
senders.py             who published a message; of several, whose messages count
runtime.py             running nodes so that they end safe; nodes as processes; their transport
robot_client.py        who speaks to a running robot: waits, sends targets, reads statuses
stopping.py            every node that can be stopped, found and stopped
"""
