"""
The monitor node: model against measurement; monitoring/ decides.

node.py         topics and services; what a tracker sends, as markers in the base frame
watching.py     drift, contact, identification while running: when, and what is published
"""
