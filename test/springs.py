"""An arm of independent springs: the simplest plant of a mock."""

from types import SimpleNamespace

import numpy as np

from tendon_robot_ros.common.errors import InputError


class Springs:
    """Wires on springs of a compliance [m/N], which may have become longer by `crept` [m]."""

    def __init__(self, compliance, highest=np.inf):
        self.compliance, self.highest, self.crept, self.calls = compliance, highest, 0.0, 0

    def respond(self, tensions):
        self.calls += 1
        if tensions.max() > self.highest:
            raise InputError('too much')
        pulls = self.compliance * tensions + self.crept
        return SimpleNamespace(inputs=tensions.copy(), pulls=pulls)

    def respond_to_pulls(self, pulls):
        known = np.nan_to_num(pulls)
        return SimpleNamespace(inputs=np.maximum(known, 0.0) / self.compliance, pulls=known)
