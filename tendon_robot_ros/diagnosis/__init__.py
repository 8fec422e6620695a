"""
Which physical effect is missing from a model, and with which confidence.

Candidates are fitted to the data (session, fitter, select), a verdict follows from the fits
(verdict), and reports read the result. The first group is the inference that all tools share; it
does not depend on verdicts.

Inference
imperfections.py      kinds of imperfections of an arm as built; the model that has them
slopes.py             derivatives of the markers by imperfections
marginal.py           marginal likelihood of random imperfections; estimates of their sizes
fit.py                a converged fit: covariance, p-values, left-out errors
search.py             bounded Gauss-Newton search for the values of parameters
fitter.py             alternating fits of parameters, imperfections and their sizes
session.py            noise, weights, and the fits of many candidates side by side
select.py             fits of all candidates; pairs and larger combinations of effects
crossval.py           errors on fitted postures, on a check set, on postures left out
intervals.py          95 % intervals of parameters, forces, and sizes of imperfections

The diagnosis
verdict.py            thresholds, and the table of the verdicts (sentence, colour, advice); the
                      threshold of the drift alarm is in monitoring/watch.py
diagnose.py           `diagnose`: from the evidence to a verdict
reference.py          what has changed since an earlier recording of the arm
candidates.py         effects that may be missing; which of them the postures test
patterns.py           patterns without a physical law, for causes outside the catalogue
local_tests.py        where the best model still misfits: cell, posture, tendon, direction
next_measurement.py   the posture that separates effects which the present ones do not
missing_moment.py     the moment that the model lacks along the arm, for pictures
trust.py              false alarm rate and detectable sizes on the user's postures
report_rows.py        from fits to the rows and numbers of a result
result.py             `Diagnosis` and `Improvement`, for reports and other tools

Mistakes of the set-up
setup_mistakes.py     which mistake explains a gross error, by itself or with an effect
setup_hypotheses.py   `Mistake`; of inputs, axes, units, gravity, stiffness
marker_hypotheses.py  of markers and cells: exchanged, displaced, miscounted

A better description
add.py                write effects into a description, and undo it
improve.py            effects join while the error on left-out postures falls
stepwise.py           the search for the next effect to add
description.py        what a fit changes in a description
"""
