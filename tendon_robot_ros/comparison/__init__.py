"""
A model against measurements: how far off, where, and how much of that is noise.

compare.py     `compare`: models and a data set to a comparison
result.py      what a comparison holds, and pictures of it; to JSON and back
outliers.py    readings and trials that the others contradict: named, and left out
predict.py     what a model with free parameters predicts for the postures of a data set
noise.py       noise of the trials and of the marker means, the noise floor; how large the error is
               that no model of a family explains
statistics.py  tails of distributions, means with intervals, the paired t-test
"""
