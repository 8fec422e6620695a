"""
The model once more, straight down from its definition: plain Python, no solver, no shortcuts.

Path lengths are distances between eyelets, moments are differences of path lengths and of the
potential energy of the loads. `implied` says which bends the model's laws ask for, given the
bends that a solver returned: at an equilibrium both are the same.
"""

import math

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

STEP = 1e-5  # [rad] of central differences
SLIP_LENGTH = 2e-6  # [m]


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

    def get(self, effect, parameter, default=0.0, section=None):
        """Return a parameter of an effect, neutral where the robot does not list it."""
        value = self.robot.effects.get(effect, {}).get(parameter, default)
        return value[self.robot.sections.index(section)] if isinstance(value, tuple) else value

    def offset(self, i, k):
        """Offset of tendon k in the middle of cell i [m]."""
        tendon, middle = self.robot.tendons[k], 0.5 * (self.starts[i] + self.starts[i + 1])
        share = middle / self.starts[self.ends[k]]
        base, end = np.array(tendon.base), np.array(tendon.end)
        scale = 1.0 + self.get('moment_arm', 'relative_change')
        return scale * (base + share * (end - base))

    def rotation(self, theta):
        """exp of the angle |theta| about z x theta."""
        return Rotation.from_rotvec([-theta[1], theta[0], 0.0]).as_matrix()

    def end(self, i, theta, length):
        """Where cell i ends, seen from where it begins [m]."""
        a = np.hypot(*theta)
        if self.sections[i].bends_as == 'hinge':
            half = np.array([0.0, 0.0, 0.5 * length])
            return half + self.rotation(theta) @ half
        if a < 1e-8:
            return length * np.array([0.5 * theta[0], 0.5 * theta[1], 1.0])
        across = (1.0 - math.cos(a)) / a
        return length * np.array([*(across * np.array(theta) / a), math.sin(a) / a])

    def lost(self, i, k, theta):
        """Path that tendon k loses in cell i from straight [m]: between its two eyelets."""
        length = self.sections[i].cell_length
        eyelet = np.array([*self.offset(i, k), 0.0])
        apart = self.end(i, theta, length) + self.rotation(theta) @ eyelet - eyelet
        straight = length - np.linalg.norm(apart)
        share = self.get('straight_tendon', 'fraction')
        return (1.0 - share) * (eyelet[:2] @ np.array(theta)) + share * straight

    def travel(self, bend):
        """Path lost since the rest shape (n, k) [m]."""
        travel = np.zeros((self.n, len(self.ends)))
        for k, cells in enumerate(self.ends):
            for i in range(cells):
                travel[i, k] = self.lost(i, k, bend[i]) - self.lost(i, k, self.rest)
        return travel

    def tensions(self, inputs, bend, signs=None):
        """Tension of every tendon in every cell (n, k) [N]; `signs` (n, k) if friction knows."""
        travel, tension = self.travel(bend), np.zeros((self.n, len(self.ends)))
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
        return (1.0 - share) * math.tanh(here / SLIP_LENGTH) + share * math.tanh(
            beyond / SLIP_LENGTH
        )

    def energy(self, bend, tension):
        """Potential energy of the loads [J]."""
        gravity = np.array(self.robot.gravity or (0.0, 0.0, 0.0))
        density = self.get('gravity', 'linear_density')
        compliance = self.get('axial_compression', 'compliance')
        force = np.array([self.get('tip_load', f'force_{c}') for c in 'xyz'])
        energy, frame, point = 0.0, np.eye(3), np.zeros(3)
        for i, section in enumerate(self.sections):
            mass = density * self.profile[i] * section.cell_length
            length = section.cell_length * (1.0 - compliance * tension[i].sum())
            middle = np.array([0.0, 0.0, 0.5 * length])
            if section.bends_as == 'arc':
                middle = self.end(i, 0.5 * bend[i], 0.5 * length)
            energy -= mass * gravity @ (point + frame @ middle)
            point = point + frame @ self.end(i, bend[i], length)
            frame = frame @ self.rotation(bend[i])
        return energy - force @ point

    def moments(self, bend, tension):
        """Bending moment on every cell (n, 2) [N·m], by virtual work."""
        moments = np.zeros((self.n, 2))
        for i in range(self.n):
            for c in range(2):
                up, down = bend.copy(), bend.copy()
                up[i, c] += STEP
                down[i, c] -= STEP
                work = self.energy(down, tension) - self.energy(up, tension)
                for k, cells in enumerate(self.ends):
                    if i < cells:
                        work += tension[i, k] * (self.lost(i, k, up[i]) - self.lost(i, k, down[i]))
                moments[i, c] = work / (2.0 * STEP)
        return moments

    def bend_under(self, i, moment, tension):
        """Bend of cell i under a moment [N·m] and the tensions in it [N]."""
        size, total, section = np.hypot(*moment), tension.sum(), self.sections[i]
        if size == 0.0:
            return self.rest
        along = moment / size
        radius = max(
            np.hypot(*self.offset(j, k)) for k, e in enumerate(self.ends) for j in range(e)
        )
        play = self.get('eyelet_clearance', 'clearance')
        size += play * total * size / max(math.hypot(size, 0.03 * total * radius), 1e-300)
        size = max(size - self.get('hinge_friction', 'lever') * total, 0.0)
        k = self.stiffness[i] * (1.0 + self.get('backbone_stiffness', 'relative_change'))
        k *= 1.0 + self.get('section_stiffness', 'relative_change', section=section)
        k += self.get('tendon_stiffness', 'per_tendon') * sum(i < cells for cells in self.ends)
        cubic = self.get('nonlinear_stiffness', 'cubic')
        most = 2.0 * size / k if cubic >= 0.0 else (-3.0 * cubic) ** -0.5  # there it gives way
        angle = brentq(lambda t: k * t * (1.0 + cubic * t * t) - size, 0.0, most, xtol=1e-15)
        return self.rest + angle * along

    def implied(self, inputs, bend, signs=None):
        """Bends (n, 2) [rad] that the laws ask for, arms and loads taken at `bend`."""
        tension = self.tensions(inputs, bend, signs)
        moments = self.moments(bend, tension)
        return np.array([self.bend_under(i, moments[i], tension[i]) for i in range(self.n)])

    def positions(self, bend, tension):
        """Distal ends of the cells (n, 3) [m]."""
        compliance = self.get('axial_compression', 'compliance')
        frame, points = np.eye(3), [np.zeros(3)]
        for i, section in enumerate(self.sections):
            length = section.cell_length * (1.0 - compliance * tension[i].sum())
            points.append(points[-1] + frame @ self.end(i, bend[i], length))
            frame = frame @ self.rotation(bend[i])
        return np.array(points[1:])

    def wire_pulls(self, bend, tension):
        """Wire pulls (k,) [m]."""
        stretch = self.get('tendon_elongation', 'compliance')
        lengths = np.array([section.cell_length for section in self.sections])
        taken = self.travel(bend).sum(axis=0) + stretch * lengths @ tension
        taken = taken + self.get('wire_spring', 'compliance') * tension[0]
        taken = taken - self.get('pull_zero', 'offset')
        return taken / (1.0 + self.get('spool_gain', 'relative_change'))
