"""
What measurements say of a model: one likelihood, one fit, one left-out error, one interval.

An arm deviates from its description by effects that it lacks, by imperfections of how it is built,
by noise, and by what no model of the family reaches. Tools that compare, diagnose, improve or
watch an arm ask with these files; none of them knows of a verdict.

Measurements
predict.py        what a model with free parameters predicts for the postures of a data set
noise.py          noise of the trials and of the marker means, the noise floor; how large the error
                  is that no model of a family explains
outliers.py       readings and trials that the others contradict: named, and left out
repeats.py        errors at equal inputs, reached in different ways: what no function explains
discrepancy.py    what an arm deviated in an earlier recording, and what has changed since
statistics.py     tails of distributions, means with intervals, the paired t-test

Likelihood
imperfections.py  kinds of imperfections of an arm as built; the model that has them, its slopes
marginal.py       marginal likelihood of random imperfections; estimates of their sizes

Fits
candidates.py     effects that may be missing; which of them the postures test
fit.py            a converged fit: covariance, p-values, left-out errors
search.py         bounded Gauss-Newton search for the values of parameters
fitter.py         alternating fits of parameters, imperfections and their sizes
session.py        noise, weights, and the fits of many candidates side by side
crossval.py       errors on fitted postures, on a check set, on postures left out
intervals.py      95 % intervals of parameters, forces, and sizes of imperfections
description.py    what a fit changes in a description
"""
