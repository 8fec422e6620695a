"""
The live page in the browser.

node.py         topics and parameters of the viewer
state.py        content of the page, from the topics
page.py         scene, cameras and panel, by viser
page_parts.py   bars, curves and tables of the page; an arm as a tube
"""
