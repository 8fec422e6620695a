"""Every threshold on which a verdict hangs; nothing else decides what is said of a data set."""

from __future__ import annotations

TESTED_FROM_CHI2 = 1.0  # whitened squared change by a typical size that counts as tested
ALARM_LEVEL = 0.005  # of the omnibus alarm and of the best candidate's alarm, each
P_SINGLE_MIN = 0.001  # p-value above which one effect is adequate
P_SEVERAL_MIN = 0.01  # and several together
APART_FROM_SCORE = 9.21  # chi² + 2 k within which candidates cannot be told apart
SAME_WITHIN_CHI2 = 0.5  # chi² below which two predictions are the same
TIE_WITHIN_SCORE = 0.5  # chi² + 2 k below which the order of the catalogue decides
EFFECTS_MAX = 3  # effects in a combination
FIRST_STEP_GAIN_MIN = 5.0  # in deviance at a first step that makes a further effect worth a fit
STRAY_SD_MAX = 3.0  # declared sd that a quantity may move
CORRELATED_FROM = 0.98  # between two parameters: their values are not told apart
