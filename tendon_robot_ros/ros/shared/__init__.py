"""
Code that the nodes share.

messages.py            messages to arrays and back; frames (TF); requests
interface.py           topics as interface.yaml declares them, and their quality of service
timing.py              times that several nodes share, each with its reason
parameters.py          declared parameters with range and unit; those of another node
lifecycle.py           lifecycle nodes that start by themselves and can be stopped; status
inbox.py               polled subscriptions and services; the topic `stop`
senders.py             publishers of a topic: which one is followed, names of the others
runtime.py             running nodes so that they end safely; nodes as processes; transport
robot_client.py        client of a running robot: sends targets, reads statuses, waits
stopping.py            stops every node that can be discovered
"""
