"""
Tables, pictures and pages that people read.

page.py               a page that opens without a network; page.css and page.js are in it
numbers.py            fitted values and arrays as people and figures need them
in_words.py           what a script prints of a result, and what a notebook shows
comparison_text.py    a comparison in words; comparison_page.py is its page
diagnosis_text.py     a diagnosis in words, and how far to trust it
arm_text.py           in words: an arm as built, readings left out, where the model is still wrong
diagnosis_page.py     the page of a diagnosis, with pictures
addition_text.py      what was added, in words
improvement_page.py   how an error fell step by step, as text and page
error_plots.py        errors per cell, posture and angle; heat maps and moments
shape_plots.py        shapes, measured and predicted
path_run.py           what was reached against what was asked
workspace_page.py     where the tip can be, as text and pages
robot_picture.py      a picture of a robot
"""
