"""
Which physical effect is missing from a model, and with which confidence.

Candidates are fitted to the data by `inference` (select), a verdict follows from the fits
(verdict), and reports read the result.

The diagnosis
verdict.py            from evidence in numbers to a verdict: thresholds, gates, sentences; the
                      threshold of the drift alarm is in monitoring/watch.py
diagnose.py           `diagnose`: from the evidence to a verdict
select.py             fits of all candidates; pairs and larger combinations of effects
patterns.py           patterns without a physical law, for causes outside the catalogue
placed.py             effects at a place to be found: a load, a string, a wall
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
"""
