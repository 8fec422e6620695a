"""
A data set as a folder of plain files (docs/data_sets.md).

folder.py             `load_dataset` and `save_dataset`
description.py        dataset.yaml: how it was taken
measurement_files.py  inputs.csv and shapes.csv: what was commanded, where the markers were
csv_file.py           strict reading of CSV; every refusal names its row
path_file.py          paths to follow, from and to CSV
"""
