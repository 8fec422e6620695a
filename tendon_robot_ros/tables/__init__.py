"""
A laboratory's tables to a data set: units, still segments, marker order, the tracker's frame.

importing.py      `import_table`: the whole way
imported.py       what it gives: a data set, `save`, and in words and one picture what
                  was taken and why
reading.py        a file to tables of named columns: text, Parquet, .c3d; refuses what is none
heads.py          the head of a text table, read by its structure, whoever wrote it
columns.py        named columns of numbers, as they were found (a DataFrame as well), and what a
                  column is, by its name
tidy.py           long tables, a row for each marker and time, to wide ones
points.py         which x, y and z are the arm's points: markers, centres of rims, bodies; columns
                  that say whether a marker was seen
recipe.py         import.yaml: every choice written out
choices.py        the columns and units that a recipe leaves open
traces.py         columns to inputs and markers over time, in SI units
clocks.py         how the clock of the tracker's file runs against that of the inputs
measuring.py      where the arm stood still: cleaned, named by posture and trial
history.py        how the arm came to its postures: what is assumed, what contradicts it, visits
marker_order.py   which marker is where on the arm
placing.py        measurements to the base frame, without trials that the others contradict
registration.py   how the tracker's frame lies in the base's, with the model's help
                  (of a live tracker: ros/monitor/measured.py)
"""

from .imported import ImportedTable
from .importing import import_table

__all__ = ['ImportedTable', 'import_table']
