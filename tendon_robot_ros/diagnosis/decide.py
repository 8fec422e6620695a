"""Every threshold on which a verdict hangs; nothing else decides what is said of a data set."""

from __future__ import annotations

TESTED_FROM = 1.0  # whitened squared change by a typical size below which an effect is not tested
ALARM_LEVEL = 0.005  # of the omnibus alarm and of the best candidate's alarm, each
P_ONE, P_SEVERAL = 0.001, 0.01  # p-values above which one effect, or several, are adequate
APART_FROM = 9.21  # chi² + 2 k within which candidates cannot be told apart
SAME_WITHIN = 0.5  # chi² below which two predictions are the same
TIE_WITHIN = 0.5  # chi² + 2 k below which the order of the catalogue decides
EFFECTS_MAX = 3  # effects in a combination
GAIN_MIN = 5.0  # in deviance at a first step that makes a further effect worth a fit
STRAY_SD_MAX = 3.0  # declared sd that a quantity may move
CORRELATED_FROM = 0.98  # between two parameters: their values are not told apart
