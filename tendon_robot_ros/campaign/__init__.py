"""
Questions that outgrow a laptop: many simulated robots, or many measured ones, all diagnosed.

plan.py       what to simulate and diagnose, read from YAML: robots x effects x sizes x designs ...
cases.py      one simulated robot: what it hides, how it is built, what is measured of it
judge.py      a case, diagnosed, held against the truth: a row of the table
table.py      the table of rows, in Parquet files that grow
running.py    a plan on workers, going on where it was
versions.py   the same package, effects and compiled kernel in every worker
fleet.py      recordings and data sets of many robots over time, compared and diagnosed
figures.py    power, confusion, intervals, false alarms and costs, counted from the table
"""
