"""
A laboratory's tables to a data set: units, still segments, marker order, the tracker's frame.

importing.py      `import_table`: tables to a data set; visits to postures in any order
imported.py       its result: the data set, in words and one picture what was taken and why
reading.py        a file to tables of named columns: text, Parquet, .c3d; long tables to wide ones
headers.py        the header of a text table, read by its structure, whoever wrote it
columns.py        named columns of numbers, as they were found (a DataFrame as well), and what a
                  column is, by its name; whether markers were seen, where a column says so
markers.py        which columns are markers (points, centres of rims, bodies), and where on the
                  arm each marker is
recipe.py         import.yaml: every choice written out; the columns and units that it leaves open
traces.py         columns to inputs and markers over time, in SI units; the tracker's clock
measuring.py      where the arm stood still: cleaned, named by posture and trial; whether it was
                  loaded from straight
registration.py   how the tracker's frame lies in the base's, with the model's help, and
                  measurements moved there (of a live tracker: ros/monitor/node.py)
"""

from .imported import ImportedTable
from .importing import import_table

__all__ = ['ImportedTable', 'import_table']
