"""
Tables, pictures and pages that people read.

page.py               a page that opens without a network, its figures and how they look; page.css
                      and page.js are in it
pictures.py           pictures that are files: a robot; what was reached of a path, also as a table
in_words.py           what a script prints of a result, and what a notebook shows
sentences.py          what several say: values with intervals, an arm as built, readings left out,
                      where the model is still wrong
comparison.py         a comparison in words, and its page; shapes, measured and predicted
diagnosis_text.py     a diagnosis in words, and how far to trust it; what was added
diagnosis_page.py     the page of a diagnosis, with pictures
improvement_page.py   how an error fell step by step, as text and page
error_plots.py        errors per cell, posture and angle; heat maps and moments
workspace_page.py     where the tip can be, as text and pages
"""
