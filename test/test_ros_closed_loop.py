"""With a measured tip the controller removes what its model leaves."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from ros_station import Station, last, start, values

pytestmark = pytest.mark.ros


def test_the_tip_of_an_arm_unlike_the_model_is_brought_to_the_target(tmp_path):
    hidden = (
        '{plant: {refine: 1, scatter: 0.0, hidden: {backbone_stiffness: {relative_change: 0.1}}}}'
    )
    with (
        start('driver', '/loop', tmp_path, config=hidden),
        start('controller', '/loop', tmp_path, tip_gain=2.0),
    ):
        station = Station('/loop')
        station.until_code(station.controller, 'holding', timeout=120.0)
        target = np.array([0.06, 0.0, 0.17])
        station.go_to_point(0.06, 0.17)
        station.until(lambda: np.linalg.norm(station.tip() - target) < 2e-4, 'the target')
        assert float(values(last(station.controller))['correction (m)']) > 1e-3
        station.until(
            lambda: float(values(last(station.controller))['measured_error (m)']) < 2e-4,
            'the status to say so',
        )
        station.close()


@pytest.mark.slow  # without nodes: test_control_tip_loop.py
def test_with_a_noisy_tracker_it_reaches_the_noise(tmp_path):
    """Scatter, a hidden effect, load cells and a tracker with noise: what `make live` mocks."""
    hidden = '{hinge_friction: {lever: 2.0e-4}}'
    config = (
        f'{{plant: {{scatter: 0.02, hidden: {hidden}}}, tension_noise: 0.002, '
        f'tracker: {{rate: 30.0, noise: {NOISE}}}}}'
    )
    with (
        start('driver', '/noisy', tmp_path, config=config),
        start('controller', '/noisy', tmp_path, tip_gain=1.0),
    ):
        station = Station('/noisy')
        station.until_code(station.controller, 'holding', timeout=120.0)
        target = np.array([0.06, 0.0, 0.17])
        station.go_to_point(0.06, 0.17)
        station.until(lambda: off(station, target) < NOISE, 'the target', timeout=30.0)
        station.spin(3.0)
        assert off(station, target) < NOISE, 'it must stay there'
        assert float(values(last(station.controller))['correction (m)']) > 1e-3
        station.close()


NOISE = 2e-4  # [m] 1 sd of one coordinate


def off(station, target):
    """Return how far the mean tip of the last second is off [m]."""
    end = station.tips[-1][0]
    recent = [message.pose.position for at, message in station.tips if end - at < 1.0]
    return float(np.linalg.norm(np.mean([[p.x, p.y, p.z] for p in recent], axis=0) - target))
