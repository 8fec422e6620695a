"""The emulated servo does what the manual says of the real one."""

import math
import os

import emulated
import numpy as np
import processes
import pytest
from control_rig import ROBOTS

from tendon_robot_ros.drivers.dynamixel.control_table import (
    BAUD_RATES,
    MODELS,
    RADIANS_PER_TICK,
    REGISTERS,
)
from tendon_robot_ros.emulator.rig import ElasticArm, HangingWeights, Rig, SpringArm, Wire, softer
from tendon_robot_ros.emulator.servo import GAINS, STEP_S, Load, Servo, StatusError
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import SAME_TENSION_N
from tendon_robot_ros.simulation.plant import make_plant

pytest.importorskip('dynamixel_sdk')
from tendon_robot_ros.drivers.dynamixel.bus import Bus

SPOOL = 0.013  # [m]


@pytest.fixture
def servo():
    return Servo(MODELS['XM430-W350'], 1)


def write(servo, name, value):
    register = REGISTERS[name]
    data = value.to_bytes(register.size, 'little', signed=register.signed)
    return servo.write(register.address, data)


def write_all(servo, **registers):
    for name, value in registers.items():
        assert write(servo, name, value) == 0, name


@pytest.mark.parametrize(
    ('before', 'name', 'value', 'error'),
    [
        ('torque_enable', 'operating_mode', 4, StatusError.ACCESS),  # flash memory is locked
        ('torque_enable', 'present_position', 5, StatusError.ACCESS),
        ('current_limit', 'goal_current', 2, StatusError.DATA_LIMIT),
        ('current_limit', 'goal_current', -1, 0),
    ],
)
def test_a_write_is_refused_with_the_error_of_the_manual(servo, before, name, value, error):
    assert write(servo, before, 1) == 0
    assert write(servo, name, value) == error


def test_values_in_part_and_addresses_behind_the_table_are_refused(servo):
    assert servo.write(REGISTERS['goal_position'].address, b'\1\0') == StatusError.DATA_LENGTH
    assert servo.read(140, 20) == (StatusError.ACCESS, b'')


@pytest.mark.parametrize('mode', [0, 4, 5])
def test_a_tripped_watchdog_stops_the_servo_and_locks_the_goals_until_zero_is_written(mode):
    # e-Manual, "Bus Watchdog(98)": it stops, 98 becomes -1, goals give a Data Range Error
    servo = Servo(MODELS['XM430-W350'], 1)
    rig = Rig([servo], [Wire(1, 0.01)], SpringArm(np.array([0.0])))
    goal, aim = ('goal_current', 300) if mode == 0 else ('goal_position', 100_000)
    write_all(servo, operating_mode=mode, torque_enable=1, bus_watchdog=5, **{goal: aim})
    servo.silence = 0.0
    for _ in range(9):  # a pause of the process would be none of the bus
        rig.advance(0.01)
    assert servo.motion.speed > 0.0
    rig.advance(0.02)
    assert servo.get('bus_watchdog') == 255
    stopped = servo.get('present_position')
    rig.advance(0.1)
    assert servo.get('present_position') == stopped
    assert write(servo, goal, 50) == StatusError.DATA_RANGE
    assert servo.torque
    write_all(servo, bus_watchdog=0, **{goal: aim})
    servo.silence = 0.0
    rig.advance(0.05)
    assert servo.motion.speed > 0.0


@pytest.mark.parametrize(
    ('startup', 'torque'), [(0, 0), (1, 1), (2, 0)]
)  # e-Manual, "Startup Configuration(60)": bit 0 switches the torque on
def test_torque_comes_on_with_the_power_where_the_startup_configuration_says_so(startup, torque):
    servo = Servo(MODELS['XM430-W350'], 1)
    servo.motion.angle = 1.0
    assert write(servo, 'startup_configuration', startup) == 0
    servo.boot()
    assert servo.get('torque_enable') == torque
    if torque:
        assert servo.get('goal_position') == servo.get('present_position') == 652


@pytest.mark.parametrize(
    ('registers', 'speed'),  # [rev/min]; a XM430-W350 turns 46 by itself
    [
        ({}, 46.0),
        ({'profile_velocity': 100}, 22.9),  # "Profile Velocity(112)": 0.229 rev/min
        ({'pwm_limit': 443}, 23.0),  # "PWM Limit(36)": 885 is 100 %
        ({'goal_pwm': 443}, 23.0),
    ],
)
def test_registers_that_steer_motion_do_what_the_manual_says(registers, speed):
    servo = Servo(MODELS['XM430-W350'], 1)
    rig = Rig([servo], [Wire(1, 0.01)], SpringArm(np.array([0.0])))
    write_all(servo, operating_mode=4, **registers, torque_enable=1, goal_position=4096)
    rig.advance(0.05)
    assert servo.motion.speed * 60.0 / (2.0 * math.pi) == pytest.approx(speed, rel=0.01)


def test_another_operating_mode_resets_gains_profile_and_pwm(servo):
    write_all(servo, position_p_gain=7, profile_velocity=5, goal_pwm=9)
    write_all(servo, operating_mode=3)  # the same
    assert servo.get('position_p_gain') == 7
    write_all(servo, operating_mode=5)
    found = [servo.get(name) for name in ('position_p_gain', 'profile_velocity', 'goal_pwm')]
    assert found == [GAINS['position_p_gain'], 0, 885]


def test_the_watchdog_rests_while_torque_is_off(servo):
    write(servo, 'bus_watchdog', 1)
    servo.protect(10.0)
    assert servo.get('bus_watchdog') == 1


@pytest.mark.parametrize(
    ('bit', 'switches_off'),
    [(0x20, True), (0x04, True), (0x10, True), (0x01, False), (0x08, False)],
)
def test_a_hardware_error_of_the_shutdown_mask_takes_the_torque_until_a_reboot(
    servo, bit, switches_off
):
    write(servo, 'torque_enable', 1)
    servo.fail(bit)
    assert servo.torque != switches_off
    assert write(servo, 'led', 1) == StatusError.ALERT
    if switches_off:
        assert write(servo, 'torque_enable', 1) == StatusError.RESULT_FAIL | StatusError.ALERT
        servo.boot()
        assert write(servo, 'torque_enable', 1) == 0


def test_a_reboot_forgets_the_turns_but_not_the_place(servo):
    servo.motion.angle = 5.25 * 2.0 * math.pi
    servo.refresh()
    assert servo.get('present_position') == 5.25 * 4096
    servo.boot()
    assert servo.get('present_position') == 1024


def test_winding_needs_more_current_than_the_load_and_paying_out_less():
    servo = Servo(MODELS['XM430-W350'], 1)
    friction = servo.motion.friction
    for torque, moves in [
        (0.5 + 0.99 * friction, 0),
        (0.5 + 1.01 * friction, 1),
        (0.5 - 0.99 * friction, 0),
        (0.5 - 1.01 * friction, -1),
    ]:
        servo.motion.speed = 0.0
        servo.motion.drive_current(
            torque / servo.model.torque_per_ampere, Load([(1.0, 0.5, 0.0)]), 1e-3
        )
        assert np.sign(servo.motion.speed) == moves


def test_a_hanging_weight_pulls_with_its_weight_once_it_is_lifted():
    arm = HangingWeights(np.array([0.5, 0.2]))
    np.testing.assert_allclose(arm.tensions(np.array([-0.1, 0.1]), 0.001), [0.0, 0.2 * 9.80665])


@pytest.mark.parametrize(
    ('compliance', 'wound', 'settled'),  # [mm/N], [mm], [N]; the wires stretch by 0.1 mm/N
    [
        ([[2.0, -1.0], [-1.0, 3.0]], [4.3, 3.2], [3.0, 2.0]),
        ([[2.0, -2.0], [-2.0, 2.0]], [4.2, -6.0], [2.0, 0.0]),  # further than the arm takes it
    ],
)
def test_an_arm_known_from_tension_to_pull_settles_on_the_tension_of_a_pull(
    compliance, wound, settled
):
    arm = ElasticArm(lambda tensions: 1e-3 * np.dot(compliance, tensions), 2, highest=10.0)
    for _ in range(4000):
        tensions = arm.tensions(1e-3 * np.array(wound), 0.001)
    np.testing.assert_allclose(tensions, settled, rtol=0.02)


def test_an_arm_that_bends_unlike_a_spring_comes_to_its_tensions_without_a_jump():
    def pulls(tensions):  # [m]: a bend, and what its arc leaves to both wires
        bend = tensions[0] - tensions[1]
        return 5e-3 * bend * np.array([1.0, -1.0]) + 1e-4 * bend**2

    def wound(tensions):
        return pulls(tensions) + 1e-4 * tensions

    arm = ElasticArm(pulls, 2, highest=10.0)
    for end in np.array([[3.0, 1.0], [4.5, 1.0], [2.0, 2.5]]):
        before = arm.tensions(wound(end), 0.0)
        np.testing.assert_allclose(arm.tensions(wound(end), 2.0 * arm.period), before, rtol=1e-6)
        path = np.array([arm.tensions(wound(end), 0.001) for _ in range(200)])
        assert np.abs(before - end).max() > 0.05  # [N]: it is not where a spring would be
        np.testing.assert_allclose(path[-1], end, atol=1e-3)
        assert (np.abs(path - end).max(axis=1) < np.abs(before - end).max() + 1e-9).all()


@pytest.mark.parametrize(
    ('compliance', 'lacks'),
    [
        ([[2.0, -2.0], [-2.0, 2.0]], False),  # antagonists
        ([[2.0, -1.0], [-6.0, 4.0]], False),  # with friction: skew, but one set of tensions
        ([[2.0, -3.0], [-6.0, 4.0]], True),  # so skew that a wire wound on would pull less
        ([[1.0, 0.0], [0.0, -1.0]], True),  # at a kink
    ],
)
def test_an_arm_that_friction_skews_too_far_counts_as_softer_until_any_wire_is_held(
    compliance, lacks
):
    compliance = 1e-3 * np.array(compliance)
    added = softer(compliance)
    assert (added > 0.0) == lacks
    held = compliance + added * np.eye(2)
    assert np.diag(held).min() > -1e-9
    assert np.linalg.det(held) > -1e-14
    assert added < 2.1 * 3e-3  # [m/N]: twice what would do, no more


def test_a_slack_wire_pulls_no_motor_however_friction_skews_the_arm():
    compliance = np.array([[2.0, -1.0], [-6.0, 4.0]]) * 1e-3  # [m/N]
    arm = ElasticArm(lambda tensions: compliance @ tensions, 2, highest=10.0)
    servos = [Servo(MODELS['XL330-M077'], i) for i in (1, 2)]
    rig = Rig(servos, [Wire(1, 0.013), Wire(2, 0.013)], arm)
    servos[0].motion.angle, servos[1].motion.angle = 0.25, -2.0
    write(servos[0], 'torque_enable', 1)  # it holds; the other one is limp
    for _ in range(300):
        rig.advance(0.001)
    assert rig.wound[1] == pytest.approx(-0.026)
    pull, stiffness = arm.resistance(1)
    assert pull < 0.0
    assert stiffness == pytest.approx(1e3 / (4.1 - 6.0 * 1.0 / 2.1), rel=1e-3)  # Schur complement
    np.testing.assert_allclose(rig.tensions, [rig.wound[0] / 2.1e-3, 0.0], rtol=0.02)


@pytest.mark.parametrize('stiffness', [1e2, 1e4, 1e6])
def test_a_motor_winds_a_spring_as_far_as_its_current_less_friction_and_not_a_step_further(
    stiffness,
):
    servo = Servo(MODELS['XL330-M077'], 1)
    rig = Rig([servo], [Wire(1, 0.013)], SpringArm(np.array([stiffness]), np.array([0.003])))
    write_all(servo, operating_mode=0, torque_enable=1, goal_current=200)
    torque = 200 * servo.model.current_unit * servo.model.torque_per_ampere
    held, path = (torque - servo.motion.friction) / 0.013, []
    for _ in range(500):
        rig.advance(0.001)
        path.append(float(rig.tensions[0]))
    assert path[-1] == pytest.approx(held, rel=1e-6)
    assert max(path) <= held * (1 + 1e-6)  # without inertia nothing carries it further
    assert np.diff(path).min() > -1e-6


def two_at_a_limit(shared):
    """Two motors on an arm whose wires share a load, and what each winds and holds at most [N]."""
    compliance = np.array([[1.0, shared], [shared, 1.0]]) * 1e-3  # [m/N]
    arm = ElasticArm(lambda tensions: compliance @ tensions, 2, highest=10.0)
    motors = [Servo(MODELS['XL330-M077'], i) for i in (1, 2)]
    for motor in motors:
        write_all(motor, operating_mode=5, current_limit=361, torque_enable=1)
    torque = 361 * motors[0].model.current_unit * motors[0].model.torque_per_ampere
    friction = motors[0].motion.friction
    rig = Rig(motors, [Wire(1, SPOOL), Wire(2, SPOOL)], arm)
    return rig, (torque - friction) / SPOOL, (torque + friction) / SPOOL


def aim(rig, wound):
    for servo, length in zip(rig.servos.values(), wound, strict=True):
        write(servo, 'goal_position', round(length / (SPOOL * RADIANS_PER_TICK)))


def drag(servo):
    return max(0.0, -servo.motion.drag) / SPOOL


def test_a_motor_that_gives_way_holds_its_limit_and_its_drag_however_fast_another_lets_go():
    """One is paid out, the other takes over what its current holds."""
    rig, _, limit = two_at_a_limit(shared=0.9)
    servo, rate = rig.servos[1], 0.05  # [m/s]
    goal, beyond = np.zeros(2), 0.0
    for target in ([0.008, 0.008], [0.012, 0.008], [0.012, 0.0]):  # [m]
        while np.abs(goal - target).max() > 0.0:
            goal += np.clip(target - goal, -rate * STEP_S, rate * STEP_S)
            aim(rig, goal)
            rig.advance(STEP_S)
            assert rig.tensions[0] < limit + drag(servo) + SAME_TENSION_N
            beyond = max(beyond, rig.tensions[0] - limit)
    damping = 0.01 * servo.model.stall_torque / servo.model.no_load_speed  # [N·m·s/rad]
    assert 0.5 < beyond / (damping * rate / SPOOL**2) < 1.0  # it gives way a little more slowly
    assert rig.highest[0] == pytest.approx(limit + beyond)
    assert limit - 0.01 < rig.held[0] < limit + SAME_TENSION_N


@pytest.mark.parametrize('shared', [-0.7, -0.9, -0.97])
def test_of_two_antagonists_at_their_limits_one_winds_and_one_holds_what_it_can(shared):
    rig, winds, holds = two_at_a_limit(shared)
    aim(rig, [0.0034, -0.0045])
    for _ in range(500):
        rig.advance(STEP_S)
    assert rig.tensions == pytest.approx([3.4 / 1.1, 0.0], abs=0.05)  # the wires stretch, too
    aim(rig, [0.0034, 0.02])
    for _ in range(500):
        rig.advance(STEP_S)
        assert rig.tensions[0] < holds + drag(rig.servos[1]) + SAME_TENSION_N
        assert rig.tensions[1] < winds + SAME_TENSION_N
    assert rig.held[0] < holds + SAME_TENSION_N
    assert rig.tensions == pytest.approx([holds, winds], abs=0.01)


def test_an_arm_that_goes_over_from_one_wire_at_its_limit_to_another_pulls_no_motor_along():
    """Each wire pulls what current and friction of its motor hold, and the drag of its gear."""
    robot = load_robot(ROBOTS / 'spatial_6.yaml')
    plant, radius, limit = make_plant(robot), 0.009, robot.tension_limits[1]
    arm = ElasticArm(lambda tensions: plant.respond(tensions).pulls, 6, 2.0 * limit, slack=0.002)
    motors = [Servo(MODELS['XL330-M077'], i + 1) for i in range(6)]
    rig = Rig(motors, [Wire(i + 1, radius) for i in range(6)], arm)
    for motor in motors:
        write_all(motor, operating_mode=0, torque_enable=1)
    model = motors[0].model
    newtons = model.current_unit * model.torque_per_ampere / radius
    most = 0.01 * model.stall_torque / radius  # [N] of drag, at the no-load speed
    command = np.full(6, 0.1)
    for wire in (0, 1):
        goal = np.where(np.arange(6) == wire, limit, 0.1)
        for part in np.linspace(0.0, 1.0, 100):  # in 0.5 s
            given = command + part * (goal - command)
            for motor, value in zip(motors, given, strict=True):
                assert write(motor, 'goal_current', round(value / newtons)) == 0
            rig.advance(0.005)
            currents = np.array([motor.motion.current for motor in motors])
            holds = (currents * model.torque_per_ampere + motors[0].motion.friction) / radius
            assert (rig.tensions < holds + most + SAME_TENSION_N).all()
        command = goal


@pytest.mark.long
def test_on_the_mock_arm_no_wire_pulls_more_than_its_motor_holds_and_all_come_to_rest():
    robot = load_robot(ROBOTS / 'kato_10_1.yaml')
    plant, radius = make_plant(robot), 0.013
    arm = ElasticArm(lambda tensions: plant.respond(tensions).pulls, 4, highest=10.0, slack=0.002)
    motors = [Servo(MODELS['XL330-M077'], i) for i in (1, 2, 3, 4)]
    rig = Rig(motors, [Wire(i, radius) for i in (1, 2, 3, 4)], arm)
    for motor in motors:
        write_all(motor, operating_mode=0, torque_enable=1)
    newtons = motors[0].model.current_unit * motors[0].model.torque_per_ampere / radius
    band = motors[0].motion.friction / radius
    random, goal = np.random.default_rng(3), np.full(4, 0.1)
    for _ in range(12):
        wanted = random.uniform(0.1, 5.0, 4) * random.choice([0.02, 1.0], 4)
        before = goal
        for part in np.linspace(0.0, 1.0, 16)[1:]:  # at about 20 N/s
            goal = before + part * (wanted - before)
            for motor, value in zip(motors, goal, strict=True):
                assert write(motor, 'goal_current', round(value / newtons)) == 0
            rig.advance(0.016)
            assert (rig.tensions < np.maximum(before, wanted) + band + 0.3).all()
        for _ in range(5):
            at_rest = rig.wound
            rig.advance(0.1)
        assert rig.wound == pytest.approx(at_rest, abs=2e-5)
        assert (rig.tensions < goal + band + newtons).all()


@pytest.fixture
def bus():
    with emulated.line() as line:
        bus = Bus(line.port, 1_000_000, 0.05)
        bus.open()
        yield bus, line
        bus.close()


@pytest.mark.parametrize('fast', [True, False])
@pytest.mark.parametrize('again', [1, 3])
def test_an_answer_that_comes_too_late_is_taken_for_no_other(bus, fast, again):
    """A bus watchdog of 4 would be an overheated motor, a torque that is on a wrong supply."""
    bus, line = bus
    bus.fast = fast
    for identity in (1, 2, 3, 4):
        assert bus.ping(identity) == 1190
        for name, value in (('torque_enable', 1), ('bus_watchdog', 4)):
            line.servo(identity).put(name, value)
    for block in (False, True):
        for _ in range(again):
            line.delay = 0.06
            if block:  # where this process was late as well there is an answer: its own
                assert set(bus.block(98, 1, [1, 2]).values()) <= {b'\x04'}
            else:
                assert bus.read(1, 'bus_watchdog') in (None, 4)
        line.delay = 0.0
        read = [bus.read(1, 'hardware_error_status') for _ in range(3)]
        assert set(read) <= {None, 0} and read[-1] == 0
        assert bus.block(70, 1, [1, 2]) == {1: b'\x00', 2: b'\x00'}
        assert bus.read(1, 'torque_enable') == 1


@pytest.mark.parametrize('fast', [True, False])
def test_the_sdk_pings_reads_and_writes_it(bus, fast):
    bus, line = bus
    bus.fast = fast
    assert bus.everyone() == dict.fromkeys((1, 2, 3, 4), 1190)
    assert bus.write(2, 'led', 1) is None
    assert line.servo(2).get('led') == 1
    assert 'not available' in bus.write(2, 'model_number', 1)
    found = bus.block(126, 10, [3, 1])
    assert int.from_bytes(found[3][6:], 'little') == line.servo(3).get('present_position')
    bus.send_goals('goal_position', {1: -5, 4: 7}, {1: (-9, 9), 4: (-9, 9)})
    processes.until(lambda: [line.servo(i).get('goal_position') for i in (1, 4)] == [-5, 7])


def test_old_firmware_knows_no_fast_read():
    with emulated.line(firmware=44) as line:
        bus = Bus(line.port, 1_000_000, 0.02)
        bus.open()
        bus.fast = True
        found = bus.block(126, 10, [1, 2])
        bus.close()
    assert set(found) == {1, 2}  # asked one by one
    assert bus.failures['no or broken answer'] == 1


@pytest.mark.parametrize('baud', [9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000])
def test_it_answers_at_its_own_baud_rate_only(baud):
    with emulated.line() as line:
        code = {v: k for k, v in BAUD_RATES.items()}[baud]
        line.servo(1).put('baud_rate', code)
        answers = {}
        for tried in (baud, 57600 if baud != 57600 else 1_000_000):
            bus = Bus(line.port, tried, 0.02)
            bus.open()
            answers[tried] = bus.ping(1)
            bus.close()
    assert list(answers.values()) == [1190, None]


def test_it_leaves_nothing_behind():
    with emulated.line() as line:
        port = line.port
        assert os.path.exists(port)
    assert not os.path.exists(os.path.dirname(port))
