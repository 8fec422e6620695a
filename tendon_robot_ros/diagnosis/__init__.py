"""
Which physical effect is missing, and how sure is that.

Candidates are fitted to the data (session, fit), the fits are judged (evidence, diagnose), and the
result is what reports read.

The verdict
decide.py             table of the verdicts (sentence, colour, advice); thresholds of naming (that
                      of the drift alarm is in monitoring/drift.py)
diagnose.py           `diagnose`: from the evidence to a verdict; what cannot be told apart
evidence.py           fits of the base model and of every candidate; what remains unexplained
candidates.py         effects that may be missing; which of them the postures test
result.py             `Diagnosis`: what the reports and other tools read
load.py               a force as people say it: its size and direction
report_rows.py        from fits to the rows and numbers of a result
trust.py              how far to trust a diagnosis on the user's own postures

Fits
session.py            one diagnosis at work: noise, weights, and the fits that it asks for
fit.py                a settled fit and what it tells
fitter.py             how a fit settles: parameters, imperfections and their sizes, in turn
race.py               fits of many candidates side by side; those far behind are left
joint.py              several effects at once: which further ones are worth a fit
search.py             the search for the best values: bounded Gauss-Newton
interval.py           95 % intervals of fitted parameters

The arm as it is built
as_built.py           kinds of imperfections and their plausible sizes; the model that has them
slopes.py             how imperfections move the markers
marginal.py           how large the scatter of every kind is: estimated by marginal likelihood
likelihood.py         the value and slopes of that likelihood, from small matrices
size_intervals.py     between which sizes it lies, 95 %
arm_report.py         the scatter as it is reported, and what is out of line
local_tests.py        where the best model is still wrong: cell, posture, tendon, direction

Before physics, and without it
setup_mistakes.py     mistakes of the set-up: which of them explains a gross error by itself
setup_search.py       mistakes against missing effects, each with the effect that helps most
mistake.py            `Mistake`: what is said of one, and the data set without it
marker_places.py      where markers may sit, and which cannot sit where they are said to
setup_hypotheses.py   what these mistakes are: swapped columns, turned axes, wrong units
marker_hypotheses.py  and those of markers and cells: exchanged, placed or counted otherwise
patterns.py           patterns without physics: does the catalogue lack the cause
next_measurement.py   the posture that would separate what the present ones cannot
missing_moment.py     which moment the model lacks where: what the pictures show

A better description
add.py                write effects into a description, and undo it
into_description.py   what was found of an arm as built, in its description
written.py            the description that a fit writes: effects alone, or the arm as found as well
improve.py            effects join while the error on left-out postures falls
as_found.py           what was found, fitted again with the arm as it is built: values, last step
stepwise.py           the search for the one that joins next
described_arm.py      what may change of the arm itself: stiffness along it, routes of tendons
prediction_errors.py  the error before, after, and left out; what slopes alone promise of it
improvement.py        `Improvement`: a better description, and how the error fell
"""
