"""With a measured tip the controller removes what its model leaves."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_station import holding, last, values

pytestmark = pytest.mark.ros


def test_the_tip_of_an_arm_unlike_the_model_is_brought_to_the_target(tmp_path):
    hidden = (
        '{plant: {refine: 1, scatter: 0.0, hidden: {backbone_stiffness: {relative_change: 0.1}}}}'
    )
    nodes = {'driver': {'config': hidden}, 'controller': {'tip_gain': 2.0}}
    with holding('/loop', tmp_path, **nodes) as station:
        target = np.array([0.06, 0.0, 0.17])
        station.go_to_point(0.06, 0.17)
        station.until(lambda: np.linalg.norm(station.tip() - target) < 2e-4, 'the target')
        assert float(values(last(station.controller))['correction (m)']) > 1e-3
        station.until(
            lambda: float(values(last(station.controller))['measured_error (m)']) < 2e-4,
            'the status to say so',
        )
