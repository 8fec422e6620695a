"""
Studies: many robots, simulated or recorded, and the paper's experiments; with their commands.

running.py         any cases on workers, into a table of rows (Parquet files that grow)
cases.py           one simulated robot: what it hides, how it is described, what is measured of it
judge.py           a case, simulated and diagnosed, held against the truth: a row; power,
                   confusion, intervals, false alarms and costs, counted from the rows
plan.py            what to simulate, read from YAML; the folder that belongs to a plan
campaign.py        command `study campaign`: a plan, run; its text and page
fleet.py           command `study fleet`: recordings of many robots over time, what changed when
rehearse.py        command `study rehearse`: a simulated arm that hides something, investigated
friction.py        command `study friction`: the coefficient from slip angles (paper, section IV.A)
paper.py           command `paper`: section IV of Kato et al. 2015, published numbers beside ours
paper_motion.py    the paper's numbers, robots and their variants; range of motion (IV.B)
paper_postures.py  posture by wire pull (IV.C) and by tension (IV.D), a bend of 90° (IV.E)

Nothing that runs on a robot imports from here.
"""
