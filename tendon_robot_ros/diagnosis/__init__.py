"""
Which physical effect is missing, and how sure is that.

Candidates are fitted to the data (session, fit), what was gathered is judged (evidence, diagnose),
and comes out as a result that the reports read.

decide.py             table of the verdicts (sentence, colour, advice); thresholds, the alarm's too
diagnose.py           `diagnose`: from the evidence to a verdict; what cannot be told apart
evidence.py           fits of the base model and of every candidate; what remains unexplained
candidates.py         effects that may be missing; which of them the postures test
session.py            one diagnosis at work: noise, weights, and the fits that it asks for
fit.py                a settled fit and what it tells
fitter.py             fits: searches, sizes of imperfections and imperfections in turn
search.py             the search for the best values: bounded Gauss-Newton
interval.py           95 % intervals of fitted parameters
cells.py              cells whose stiffness scatters
as_built.py           imperfections of an arm, and what no model reaches
split.py              the model of an arm whose cells are each a little off
slopes.py             how imperfections move the markers
marginal.py           the likelihood in which they are random
likelihood.py         its value and slopes, from small matrices
arm_report.py         how much an arm scatters, and what is out of line
local_tests.py        where the best model is still wrong: cell, posture, tendon, direction
outliers.py           readings and trials that the others contradict
setup_mistakes.py     mistakes of the set-up, before physics: which of them explains a gross error
setup_hypotheses.py   what they are: swapped columns, turned axes, wrong units
patterns.py           patterns without physics: does the catalogue lack the cause
result.py             `Diagnosis`: what the reports and other tools read
load.py               a force as people say it: its size and direction
report_rows.py        from fits to the rows and numbers of a result
next_measurement.py   the posture that would separate what the present ones cannot
missing_moment.py     which moment the model lacks where: what the pictures show
add.py                write effects into a description, and undo it
into_description.py   what was found of an arm as built, in its description
improve.py            effects join while the error on left-out postures falls
stepwise.py           the search for the one that joins next
promise.py            what a block that may join promises, by slopes alone
described_arm.py      what may change of the arm itself: stiffness along it, routes of tendons
improvement.py        `Improvement`: a better description, and how the error fell
prediction_errors.py  the error before, after, and left out
trust.py              how far to trust a diagnosis on the user's own postures
"""
