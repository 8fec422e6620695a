"""
Which physical effect is missing, and how sure is that.

Candidates are fitted to the data (session, fitter, select), the fits are judged (verdict), and the
result is what reports read. The first group is the inference that all tools share; it knows
nothing of verdicts.

Inference
imperfections.py      kinds of imperfections of an arm as built; the model that has them
slopes.py             how imperfections move the markers
marginal.py           marginal likelihood of random imperfections; their sizes, estimated
fit.py                a converged fit and what it tells
search.py             bounded Gauss-Newton search for the values of parameters
fitter.py             parameters, imperfections and their sizes, fitted in turn
session.py            noise, weights, and the fits of many candidates side by side
select.py             fits of all candidates; pairs and larger combinations of effects
crossval.py           errors on fitted postures, on a check set, on postures left out
intervals.py          95 % intervals of parameters, forces, and sizes of imperfections

The diagnosis
verdict.py            thresholds, and the table of the verdicts (sentence, colour, advice); the
                      threshold of the drift alarm is in monitoring/watch.py
diagnose.py           `diagnose`: from the evidence to a verdict; what cannot be told apart
candidates.py         effects that may be missing; which of them the postures test
patterns.py           patterns without physics: does the catalogue lack the cause
local_tests.py        where the best model is still wrong: cell, posture, tendon, direction
next_measurement.py   the posture that would separate what the present ones cannot
missing_moment.py     which moment the model lacks where: what the pictures show
trust.py              how far to trust a diagnosis on the user's own postures
report_rows.py        from fits to the rows and numbers of a result
result.py             `Diagnosis` and `Improvement`: what the reports and other tools read

Mistakes of the set-up
setup_mistakes.py     which mistake explains a gross error, by itself or with an effect
setup_hypotheses.py   `Mistake`; of inputs, axes, units, gravity, stiffness
marker_hypotheses.py  of markers and cells: exchanged, placed or counted otherwise

A better description
add.py                write effects into a description, and undo it
improve.py            effects join while the error on left-out postures falls
stepwise.py           the search for the effect that joins next
description.py        what a fit changes in a description
"""
