"""
The thresholds by which a verdict is found, and the one table of what a verdict is.

`diagnose` decides by them. What belongs to one test alone stands beside it: readings that others
contradict in comparison/outliers.py, the noise of trials in comparison/noise.py, drift in
monitoring/watch.py.

Nothing else decides what is said of a data set; the reports, the monitor and the live page read
what is said from here.
"""

from __future__ import annotations

from enum import StrEnum

TESTED_FROM_CHI2 = 1.0  # whitened squared change by a typical size that counts as tested
ALARM_LEVEL = 0.005  # of the omnibus alarm, of the best candidate's and of a pattern's, each
MISFIT_ALARM_LEVEL = 1e-4  # of the omnibus alarm of an arm as built, whose scatter is estimated
P_SINGLE_MIN = 0.001  # p-value above which one effect is adequate
P_SEVERAL_MIN = 0.01  # and several together
APART_FROM_SCORE = 9.21  # chi² + 2 k within which candidates cannot be told apart
SAME_WITHIN_CHI2 = 0.5  # chi² below which two predictions are the same
NEAR_SCORE = 60.0  # chi² + 2 k beyond the best from which a candidate is out of the race
TIE_WITHIN_SCORE = 0.5  # chi² + 2 k below which the order of the catalogue decides
EFFECTS_MAX = 3  # effects in a combination
PAIRED_MAX = 7  # best single effects whose pairs are tried
FIRST_STEP_GAIN_MIN = 5.0  # in deviance at a first step that makes a further effect worth a fit
STRAY_SD_MAX = 3.0  # declared sd that a quantity may move
LEFT_OUT_SHARE_MAX = 0.95  # of the left-out error, from which imperfections are written as well
CORRELATED_FROM = 0.98  # between two parameters: their values are not told apart
POSTURES_MIN = 3  # measured postures from which anything is judged
POSTURES_ENOUGH = 6  # below which it is said that they are few
COVERED_SHARE_MIN = 0.9  # of the arm that markers reach, below which that is said
NOISE_FACTOR_MAX = 2.0  # from the declared noise to that of the trials, beyond which it is said
ODD_FROM_FLOORS = 10.0  # noise floors of error from which a mistake of the set-up is looked for
FRAME_TURNED_MIN_DEG = 10.0  # by which the frame of the tracker is turned in a mistake
FRAME_OFF_SHARE_MIN = 0.1  # of the length of the arm, by which it is shifted in one
GROSS_FROM_FLOORS = 20.0  # and from which the frame of the tracker may be far off
FRAME_HARDLY_KNOWN_RAD = 0.017  # tolerance of its rotation from which the model has found it
FRAME_LEVEL_RAD = 0.05  # below which only the turn about the vertical was found so
ERROR_SHARE_LEFT_MAX = 0.1  # of the error, that a mistake may leave
QUIET_WITHIN_FLOORS = 5.0  # of error that the best effect leaves: no mistake is looked for
EXPLAINED_WITHIN_FLOORS = 8.0  # or so many noise floors, if that is more
ERROR_SHARE_LEFT_LIMIT = 0.3  # of the error, that it may leave in any case
PLAIN_WITHIN_FLOORS = (
    1.2  # floors of an arm built as usual; a mistake that leaves more is no proof
)
PARTLY_LEFT_MAX = 0.6  # of the error, that a mistake may leave where effects are at work as well
PARTLY_TRIED_MAX = 3  # such mistakes without which the measurements are judged again
STIFFNESS_FACTOR_MAX = 1.9  # by which a value may be off: two is a mistake, told to 5 %
MISTAKE_HANDICAP = 6.0  # of score against effects: some twenty ways of miscounting are tried
AS_GOOD_WITHIN = 1.3  # times the least error left: then the plainest mistake is said
CUT_AS_GOOD_WITHIN = 1.05  # the same of a number of cells where markers were cut at the tip
STILL_SHARE_MAX = 0.05  # of the way that a marker should go, below which it is frozen
STILL_FROM_FLOORS = 10.0  # noise floors that it should go by at least to be called so
NOISE_WITHIN_FLOORS = 1.25  # noise floors up to which what is left equals the repeatability
PATTERN_SHARE_MIN = 0.33  # of the excess in deviance that a pattern takes to be told of
SEPARABLE_FROM_SD = 2.0  # sd of a mean that predictions must differ to be worth a measurement
FALSE_OUT_OF_LINE_PROBABILITY = 0.05  # that any member of a healthy arm is called out of line
TOLD_SPAN_MAX = 30.0  # upper over lower end of the interval of a plausible scatter that is told
FALSE_DISCOVERY_RATE = 0.05  # among the places at which the best model is said to be wrong
LOCAL_FAULTS_MAX = 8  # places that are named
LOCAL_BEND_MAX_RAD = 0.5  # that one cell may be kinked by to be called so
LOCAL_CHANGE_MAX = 3.0  # relative, of the stiffness of one cell, by slopes
LOCAL_SHARE_MIN = 0.02  # of what a fault does, that a fit must not be able to do as well
ADD = 'Add it to the robot description: `{command} --add better.yaml`'
CLICK_3 = 'Found. Click 3: the model gets the effect while the arm goes on.'


class Verdict(StrEnum):
    """
    What a diagnosis ends in; its value is its name in files and topics.

    Attributes
    ----------
    sentence : str
        What it says; `report.diagnosis_text` fills in the names, values and errors.
    colour : str
        Key of `common.colours.KINDS`, for the box that it stands in.
    advice : str
        What to type next where effects were found; `{command}` is the diagnosis itself.
    guide : str
        What to click next on the live page.
    may_add : bool
        Whether its effects are added without the user insisting.
    judged : bool
        Whether effects were judged at all.

    """

    sentence: str
    colour: str
    advice: str
    guide: str
    may_add: bool
    judged: bool

    def __new__(
        cls,
        name: str,
        sentence: str = '',
        colour: str = '',
        advice: str = '',
        guide: str = '',
        may_add: bool = False,
        judged: bool = True,
    ) -> Verdict:
        """Make a row of the table."""
        self = str.__new__(cls, name)
        self._value_, self.sentence, self.colour, self.advice = name, sentence, colour, advice
        self.guide, self.may_add, self.judged = guide, may_add, judged
        return self

    ADEQUATE = (
        'adequate',
        'ADEQUATE{for_accuracy}: nothing is missing that {judged_by}.',
        'good',
        '',
        'Nothing is missing that these postures could show. Click 1 to record others.',
    )
    MISSING_EFFECT = (
        'missing_effect',
        'CONSISTENT WITH {values}.\nIt explains {share}.',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    SEVERAL = (
        'several',
        'CONSISTENT WITH {names} together: {values}.\nThey explain {share}.',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    WRONG_PARAMETER = (
        'wrong_parameter',
        'WRONG PARAMETER: {what_is_off}.\nCONSISTENT WITH {values}{instead}.',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    AMBIGUOUS = (
        'ambiguous',
        'AMBIGUOUS: {alike} explain {these_postures} equally well ({share}).\n'
        'If it is {best}: {best_values}.',
        'warn',
        'Until that is measured, the first of them will do: `{command} --add better.yaml`',
        CLICK_3,
        True,
    )
    OUTSIDE_CATALOGUE = (
        'outside_catalogue',
        'OUTSIDE THE CATALOGUE: {what_remains}.',
        'bad',
        'Nothing is added by itself; if part of the way helps: '
        '`{command} --add better.yaml --partial`; several, while the error on left-out postures '
        'falls: `improve`',
        'The catalogue has no name for this cause, so nothing is added. What the remainder looks '
        'like is said below.',
    )
    CANNOT_JUDGE = (
        'cannot_judge',
        'CANNOT JUDGE: {remainder}.',
        'warn',
        '',
        'The recording does not suffice. Click 1 to record again.',
        False,
        False,
    )
