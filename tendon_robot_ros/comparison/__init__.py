"""
A model against measurements: how far off, where, and how much of that is noise.

compare.py      `compare`: models and a data set to a comparison
result.py       what a comparison holds, and pictures of it
saved.py        a comparison to JSON and back (the file is cli/options.py's)
outliers.py     readings and trials that the others contradict: named, and left out
contradictions.py  which these are: deletion statistics of the trials of a posture
conditions.py   what acted on the arm in some of the postures
predict.py      what a model with freed parameters predicts for the postures of a data set
tangent.py      how settled postures follow what moves a little
repeatability.py  what the trials of a posture tell of the noise
noise.py        noise of the marker means, input noise through the model, the noise floor; how
                large is what no model of a family explains
statistics.py   means with intervals, the paired t-test, tails of distributions
"""
