"""
The model once more, straight down from its definition: plain Python, no solver, no shortcuts.

Path lengths are distances between eyelets, moments are differences of path lengths and of the
potential energy of the loads. `implied` says which state the model's laws ask for, given the
one that a solver returned: at an equilibrium both are the same. A state (3n,) holds the bends
(n, 2) and behind them the twists (n,).
"""

import math
from functools import cache, lru_cache

import numpy as np
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation

STEP = 1e-5  # [rad] of central differences
SMOOTHING_LENGTH = 2e-6  # [m]


def about_z(angle, x, y):
    """Turn an offset (x, y) about the axis."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * x - s * y, s * x + c * y])


@lru_cache(1000)  # the tendons of a cell ask for the same
def turn(x, y, z):
    """Return the matrix of a rotation vector [rad]."""
    matrix = Rotation.from_rotvec([x, y, z]).as_matrix()
    matrix.flags.writeable = False
    return matrix


class Reference:
    """A robot's laws; cells count from 0."""

    def __init__(self, robot):
        self.robot = robot
        self.sections = [s for s in robot.sections for _ in range(s.cells)]
        self.stiffness = [k for s in robot.sections for k in s.bending_stiffness]
        self.profile = [m for s in robot.sections for m in s.mass_profile]
        self.n, self.ends = robot.cells, robot.tendon_cells
        self.starts = np.cumsum([0.0] + [s.cell_length for s in self.sections])
        self.rest = np.array([self.get('pre_curvature', f'angle_{c}') for c in 'xy'])
        self.offset, self.eyelets, self.lost_at_rest = map(
            cache, (self.offset, self.eyelets, self.lost_at_rest)
        )

    def get(self, effect, parameter, default=0.0, section=None):
        """Return a parameter of an effect, neutral where the robot does not list it."""
        value = self.robot.effects.get(effect, {}).get(parameter, default)
        return value[self.robot.sections.index(section)] if isinstance(value, tuple) else value

    def cells(self, state):
        """Bends and twist (n, 3) of the cells."""
        bends = np.reshape(state[: 2 * self.n], (self.n, 2))
        return np.column_stack([bends, state[2 * self.n :]])

    def route(self, k, place):
        """Offset of tendon k at an arc length [m]: on a line that winds about the axis."""
        tendon, share = self.robot.tendons[k], place / self.starts[self.ends[k]]
        base, end = np.array(tendon.base), np.array(tendon.end)
        scale = 1.0 + self.get('moment_arm', 'relative_change')
        return scale * about_z(tendon.helix * place, *(base + share * (end - base)))

    def offset(self, i, k):
        """Offset of tendon k in the middle of cell i [m]."""
        return self.route(k, 0.5 * (self.starts[i] + self.starts[i + 1]))

    def eyelets(self, i, k):
        """Offsets of tendon k at the ends of cell i [m]: that of its middle, wound both ways."""
        (x0, y0), (x1, y1) = (self.route(k, self.starts[j]) for j in (i, i + 1))
        half = math.atan2(x0 * y1 - y0 * x1, 0.5 * ((x0 + x1) ** 2 + (y0 + y1) ** 2))
        at = self.offset(i, k)
        return np.array([*about_z(-half, *at), 0.0]), np.array([*about_z(half, *at), 0.0])

    def bending(self, theta):
        """exp of the angle |theta| about z x theta."""
        return turn(-theta[1], theta[0], 0.0)

    def half_twist(self, twist):
        """Turn about the axis by half a twist."""
        return turn(0.0, 0.0, 0.5 * twist)

    def rotation(self, cell):
        """Turn of a cell (x, y, twist): half its twist, its bend, half its twist."""
        twist = self.half_twist(cell[2])
        return twist @ self.bending(cell[:2]) @ twist

    def end(self, i, cell, length):
        """Where cell i ends, seen from where it begins [m]."""
        return self.half_twist(cell[2]) @ self.bent_end(i, cell[:2], length)

    def bent_end(self, i, theta, length):
        """Where cell i ends, in the frame that bends [m]."""
        a = np.hypot(*theta)
        if self.sections[i].bends_as == 'hinge':
            half = np.array([0.0, 0.0, 0.5 * length])
            return half + self.bending(theta) @ half
        if a < 1e-8:
            return length * np.array([0.5 * theta[0], 0.5 * theta[1], 1.0])
        across = (1.0 - math.cos(a)) / a
        return length * np.array([*(across * np.array(theta) / a), math.sin(a) / a])

    def lost(self, i, k, cell):
        """
        Path that tendon k loses in cell i from straight [m]: between its two eyelets.

        The part along the chord of the backbone is what `straight_tendon` blends with the arm's
        bend; what lies across it, because the tendon leans, is added as it is.
        """
        length, theta = self.sections[i].cell_length, cell[:2]
        first, last = self.eyelets(i, k)
        apart = self.end(i, cell, length) + self.rotation(cell) @ last - first
        back = self.half_twist(-cell[2])
        mean = 0.5 * (back @ first + back.T @ last)
        along = np.linalg.norm(self.bent_end(i, theta, length) + self.bending(theta) @ mean - mean)
        leaning = max(apart @ apart - along**2, 0.0)
        share = self.get('straight_tendon', 'fraction')
        blend = (1.0 - share) * (mean[:2] @ np.array(theta)) + share * (length - along)
        whole = math.hypot(length, np.linalg.norm(last - first))
        return whole - math.hypot(length - blend, math.sqrt(leaning))

    def lost_at_rest(self, i, k):
        """Path that tendon k loses in cell i of the arm at rest [m]."""
        return self.lost(i, k, np.array([*self.rest, 0.0]))

    def travel(self, state):
        """Path lost since the rest shape (n, k) [m]."""
        travel = np.zeros((self.n, len(self.ends)))
        for i, cell in enumerate(self.cells(state)):
            for k, cells in enumerate(self.ends):
                if i < cells:
                    travel[i, k] = self.lost(i, k, cell) - self.lost_at_rest(i, k)
        return travel

    def tensions(self, inputs, state, signs=None):
        """Tension of every tendon in every cell (n, k) [N]; `signs` (n, k) if friction knows."""
        travel, tension = self.travel(state), np.zeros((self.n, len(self.ends)))
        bend = self.cells(state)[:, :2]
        mu = self.get('tendon_friction', 'friction_coefficient')
        for j, members in enumerate(self.robot.input_tendons):
            t = inputs[j] * (1.0 - self.get('transmission_loss', 'fraction'))
            tension[0, list(members)] = max(t + self.get('tension_offset', 'offset') * (t > 0), 0)
        for i in range(self.n - 1):
            wrap = self.get('eyelet_wrap', 'fraction')
            turn = (1.0 - wrap) * math.sin(0.5 * np.hypot(*bend[i]))
            turn += wrap * math.sin(0.25 * np.hypot(*(bend[i] + bend[i + 1])))
            for k, cells in enumerate(self.ends):
                if i + 1 < cells:
                    s = self.sign(travel[:, k], i) if signs is None else signs[i, k]
                    ratio = (1.0 - mu * turn) / (1.0 + mu * turn)
                    tension[i + 1, k] = tension[i, k] * ratio**s
        return tension

    def sign(self, travel, i):
        """Direction of friction at the eyelet behind cell i."""
        share = self.get('tendon_travel', 'fraction')
        here, beyond = travel[i], travel[i + 1 :].sum()
        return (1.0 - share) * math.tanh(here / SMOOTHING_LENGTH) + share * math.tanh(
            beyond / SMOOTHING_LENGTH
        )

    def pushes(self, state, tension):
        """Return forces [N] and moments [N·m] (n, 3) on the ends of the cells, before they bow."""
        force, moment = np.zeros((self.n, 3)), np.zeros((self.n, 3))
        for i, (point, frame) in enumerate(self.ends_of(state, tension)):
            for name in ('point_load', 'tether'):
                share = np.interp(
                    self.get(name, 'arc_length'), self.starts, np.eye(self.n + 1)[i + 1]
                )
                turned = np.eye(3) + self.get(name, 'follows') * (frame - np.eye(3))
                wrench = self.vector(name, 'force'), self.vector(name, 'moment')
                if name == 'tether':
                    away = self.vector(name, 'point') - point
                    over = np.linalg.norm(away) - self.get(name, 'slack_length')
                    pull = self.get(name, 'tension') + self.get(name, 'stiffness') * over
                    wrench = (over > 0.0) * pull * away / np.linalg.norm(away), np.zeros(3)
                force[i] += share * turned @ wrench[0]
                moment[i] += share * turned @ wrench[1]
            force[i] += self.push_of_pole(point, point - [0.0, 0.0, self.starts[i + 1]])
        return force, moment

    def push_of_pole(self, point, moved):
        """Force of a pole on a point (3,) [N] that has moved (3,) [m] from the straight arm."""
        if not self.get('contact', 'stiffness'):
            return np.zeros(3)
        radius, (up, about) = (
            1.0 / self.get('contact', 'curvature'),
            (self.get('contact', key) for key in ('elevation', 'azimuth')),
        )
        normal = turn(0.0, 0.0, about) @ turn(0.0, -up, 0.0) @ [1.0, 0.0, 0.0]
        axis = (
            turn(0.0, 0.0, about) @ turn(0.0, -up, 0.0) @ turn(self.get('contact', 'axis'), 0, 0)
        )
        off = point + (self.get('contact', 'distance') + radius) * normal
        off = off - (off @ axis[:, 1]) * axis[:, 1]
        depth = radius + self.get('contact', 'thickness') - np.linalg.norm(off)
        out, hard = off / np.linalg.norm(off), self.get('contact', 'stiffness')
        normal, slips = hard * max(depth, 0.0), moved - (moved @ out) * out
        most = self.get('contact', 'friction_coefficient') * normal
        return normal * out - min(hard, most / np.linalg.norm(slips)) * slips

    def vector(self, effect, stem):
        """Components x, y, z of a parameter (3,)."""
        return np.array([self.get(effect, f'{stem}_{axis}') for axis in 'xyz'])

    def ends_of(self, state, tension):
        """Where cells end (3,) [m], before they bow, and their frames there (3, 3)."""
        compliance = self.get('axial_compression', 'compliance')
        frame, point = np.eye(3), np.zeros(3)
        for i, section in enumerate(self.sections):
            length = section.cell_length * (1.0 - compliance * tension[i].sum())
            point = point + frame @ self.end(i, self.cells(state)[i], length)
            frame = frame @ self.rotation(self.cells(state)[i])
            yield point, frame

    def energy(self, state, tension, forces):
        """Potential energy of the loads [J], and of forces (n, 3) [N] on the ends of the cells."""
        gravity = np.array(self.robot.gravity or (0.0, 0.0, 0.0))
        compliance = self.get('axial_compression', 'compliance')
        force = self.vector('tip_load', 'force')
        energy, frame, point = 0.0, np.eye(3), np.zeros(3)
        for i, section in enumerate(self.sections):
            mass = self.mass(i)
            length = section.cell_length * (1.0 - compliance * tension[i].sum())
            cell, middle = self.cells(state)[i], np.array([0.0, 0.0, 0.5 * length])
            if section.bends_as == 'arc':
                middle = self.bent_end(i, 0.5 * cell[:2], 0.5 * length)
            if section.mass_offset:
                beside = section.mass_offset[self.place(i)]
                middle = middle + self.bending(0.5 * cell[:2]) @ [*beside, 0.0]
            over, spring = self.bow(i, cell, frame, forces)
            at = point + frame @ self.half_twist(cell[2]) @ middle
            energy += spring - mass * gravity @ (at + 0.5 * over)
            point = point + frame @ self.end(i, cell, length) + over
            frame = frame @ self.rotation(cell)
            energy -= forces[i] @ point
        return energy - force @ point

    def mass(self, i):
        """Mass of cell i [kg]."""
        density = self.get('gravity', 'linear_density')
        return density * self.profile[i] * self.sections[i].cell_length

    def bow(self, i, cell, frame, forces):
        """
        How far a loaded rod ends beyond its arc [m], and the energy of that in the rod [J].

        The next mode of its curvature after the mean one: q (1 - 2 s / L) along the cell, which
        takes the end by q L² / 6 and costs EI q² L / 6.
        """
        length, none = self.sections[i].cell_length, (np.zeros(3), 0.0)
        if self.sections[i].bends_as == 'hinge':
            return none
        beyond = sum(self.mass(j) for j in range(i + 1, self.n)) + 0.5 * self.mass(i)
        force = self.vector('tip_load', 'force') + forces[i:].sum(axis=0)
        force = force + beyond * np.array(self.robot.gravity or (0.0, 0.0, 0.0))
        frame = frame @ self.half_twist(cell[2]) @ self.bending(0.5 * cell[:2])
        rigidity = self.bending_stiffness(i) * length
        across = force - (force @ frame[:, 2]) * frame[:, 2]
        q = 0.5 * length * across / rigidity
        return q * length**2 / 6.0, rigidity * q @ q * length / 6.0

    def place(self, i):
        """Which cell of its section cell i is."""
        return sum(section is self.sections[i] for section in self.sections[:i])

    def moments(self, state, tension):
        """Moment (x, y, about the axis) on every cell (n, 3) [N·m], by virtual work."""
        moments = np.zeros((self.n, 3))
        forces, held = self.pushes(state, tension)
        held[-1] += self.vector('tip_load', 'moment')
        for i in range(self.n):
            for c in range(3):
                step = np.zeros(3 * self.n)
                step[2 * i + c if c < 2 else 2 * self.n + i] = STEP
                up, down = self.cells(state + step)[i], self.cells(state - step)[i]
                work = self.energy(state - step, tension, forces)
                work -= self.energy(state + step, tension, forces)
                frames = (self.ends_of(state + side, tension) for side in (step, -step))
                for moment, (_, after), (_, before) in zip(held, *frames, strict=True):
                    turning = after @ before.T
                    work += (
                        0.5
                        * moment
                        @ (turning[[2, 0, 1], [1, 2, 0]] - turning[[1, 2, 0], [2, 0, 1]])
                    )
                for k, cells in enumerate(self.ends):
                    if i < cells:
                        work += tension[i, k] * (self.lost(i, k, up) - self.lost(i, k, down))
                moments[i, c] = work / (2.0 * STEP)
        return moments

    def bending_stiffness(self, i):
        """Bending stiffness of cell i [N·m/rad]."""
        k = self.stiffness[i] * (1.0 + self.get('backbone_stiffness', 'relative_change'))
        section = self.sections[i]
        k *= 1.0 + self.get('section_stiffness', 'relative_change', section=section)
        return k + self.get('tendon_stiffness', 'per_tendon') * sum(i < e for e in self.ends)

    def bend_under(self, i, moment, tension):
        """Bend of cell i under a moment [N·m] and the tensions in it [N]."""
        size, total = np.hypot(*moment), tension.sum()
        if size == 0.0:
            return self.rest
        along = moment / size
        radius = max(
            np.hypot(*self.offset(j, k)) for k, e in enumerate(self.ends) for j in range(e)
        )
        play = self.get('eyelet_clearance', 'clearance')
        size += play * total * size / max(math.hypot(size, 0.03 * total * radius), 1e-300)
        size = max(size - self.get('hinge_friction', 'lever') * total, 0.0)
        k = self.bending_stiffness(i)
        cubic = self.get('nonlinear_stiffness', 'cubic')
        most = 2.0 * size / k if cubic >= 0.0 else (-3.0 * cubic) ** -0.5  # there it gives way
        angle = brentq(lambda t: k * t * (1.0 + cubic * t * t) - size, 0.0, most, xtol=1e-15)
        bend = self.rest + angle * along
        lag = self.get('bending_hysteresis', 'lag', section=self.sections[i])
        if lag == 0.0:
            return bend
        rate = self.get('bending_hysteresis', 'presliding', 1.0) / lag

        def excess(b):  # of an arm that comes from straight
            t, turned = b - self.rest, np.hypot(*b)
            held = k * lag * (1.0 - math.exp(-rate * turned)) * b / max(turned, 1e-300)
            return k * t * (1.0 + cubic * t @ t) + held - size * along

        return root(excess, bend, tol=1e-14).x

    def implied(self, inputs, state, signs=None):
        """State (3n,) [rad] that the laws ask for, arms and loads taken at `state`."""
        tension = self.tensions(inputs, state, signs)
        moments = self.moments(state, tension)
        bends = [self.bend_under(i, moments[i, :2], tension[i]) for i in range(self.n)]
        twists = [
            self.get('torsion', 'compliance', section=section)
            * moments[i, 2]
            / self.bending_stiffness(i)
            for i, section in enumerate(self.sections)
        ]
        return np.concatenate([np.ravel(bends), twists])

    def positions(self, state, tension):
        """Distal ends of the cells (n, 3) [m]."""
        compliance = self.get('axial_compression', 'compliance')
        (forces, _), frame = self.pushes(state, tension), np.eye(3)
        points = [np.zeros(3)]
        for i, section in enumerate(self.sections):
            length = section.cell_length * (1.0 - compliance * tension[i].sum())
            cell = self.cells(state)[i]
            over, _ = self.bow(i, cell, frame, forces)
            points.append(points[-1] + frame @ self.end(i, cell, length) + over)
            frame = frame @ self.rotation(cell)
        return np.array(points[1:])

    def wire_pulls(self, state, tension):
        """Wire pulls (k,) [m]."""
        stretch = self.get('tendon_elongation', 'compliance')
        lengths = np.array([section.cell_length for section in self.sections])
        taken = self.travel(state).sum(axis=0) + stretch * lengths @ tension
        taken = taken + self.get('wire_spring', 'compliance') * tension[0]
        taken = taken - self.get('pull_zero', 'offset')
        return taken / (1.0 + self.get('spool_gain', 'relative_change'))

    def passed(self, commanded):
        """Wire pulls (b, m) [m] that pass the transmission, one posture after the other."""
        half = 0.5 * self.get('backlash', 'width')
        rows, there = [], np.zeros(np.shape(commanded)[1])
        for row in commanded:
            ahead, behind = row > there + half, row < there - half
            there = np.where(ahead, row - half, np.where(behind, row + half, there))
            rows.append(np.where(np.isnan(row), np.nan, there))
        return np.array(rows)
