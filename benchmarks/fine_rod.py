"""
A tendon-driven rod in space, solved without the package: the judge of spatial arms with friction.

A rod of many short elements, disks on it, wires that run straight from hole to hole. At every hole
a wire turns by the angle between its two segments and loses tension as Euler and Eytelwein say,
T' = T exp(-mu angle), against the way that it slides. The rod's moment at an element is that of
all forces beyond it. Nothing of docs/model.md is used: no cells, no moment arms, no sweep.
"""

from dataclasses import dataclass

import numpy as np

G = 9.81  # [m/s²]
SLIDES_M = 20e-6  # [m] of travel over which friction turns round
HISTORY = 8  # iterates of Anderson's acceleration
STEP_MAX_RAD = 0.02  # [rad] of an element, at once
SETTLED_RAD = 1e-9


@dataclass(frozen=True)
class FineRod:
    """A level rod along z, +x down, with disks at equal distances and a plate with holes below."""

    length: float  # [m]
    disks: int  # without the base plate
    elements: int  # of the rod between two disks
    rigidity: float  # [N·m²]
    holes: np.ndarray  # (k, 3) [m] from the axis, in the frame of a disk
    friction: float  # coefficient
    arm_mass: float  # [kg] spread over the length
    tip_mass: float  # [kg]
    plate: bool = True  # whether wires turn in holes of the base plate, too
    softness: tuple[float, ...] = ()  # (disks,) of the rod between two disks, 1: as said

    @property
    def count(self):
        """Number of elements."""
        return self.disks * self.elements

    def disk_positions(self, tensions):
        """Return where the disks are (disks, 3) [m] under tensions (k,) [N]."""
        return self._chain(self._bends(np.asarray(tensions, dtype=float)))[0][:: self.elements][1:]

    def _chain(self, bends):
        """Return nodes (n+1, 3), their frames, hinges (n, 3) and the frames in mid-hinge."""
        n, step = self.count, self.length / self.count
        angle = np.hypot(*bends.T)
        size = np.where(angle < 1e-14, 1.0, angle)
        cross = np.zeros((n, 3, 3))  # of the axis z x u
        cross[:, 0, 2] = bends[:, 0] / size
        cross[:, 1, 2] = bends[:, 1] / size
        cross[:, 2, :2] = -cross[:, :2, 2]
        turn = np.eye(3) + np.sin(angle)[:, None, None] * cross
        turn = turn + (1.0 - np.cos(angle))[:, None, None] * (cross @ cross)
        nodes, frames = np.zeros((n + 1, 3)), np.empty((n + 1, 3, 3))
        hinges, frames[0] = np.empty((n, 3)), np.eye(3)
        for i in range(n):
            hinges[i] = nodes[i] + frames[i][:, 2] * step / 2.0
            frames[i + 1] = frames[i] @ turn[i]
            nodes[i + 1] = hinges[i] + frames[i + 1][:, 2] * step / 2.0
        middle = 0.5 * (frames[:-1] + frames[1:])
        return nodes, frames, hinges, middle / np.linalg.norm(middle, axis=1, keepdims=True)

    def _wires(self, nodes, frames):
        """Return holes (disks+1, k, 3), directions of the segments and their lengths."""
        at = slice(None, None, self.elements)
        holes = nodes[at, None] + np.einsum('dij,kj->dki', frames[at], self.holes)
        segments = holes[1:] - holes[:-1]
        lengths = np.linalg.norm(segments, axis=2)
        return holes, segments / lengths[..., None], lengths

    def _segment_tensions(self, tensions, directions, lengths):
        """Return the tension (disks, k) of every segment: capstans from the base on."""
        lost = (self.length / self.disks - lengths)[::-1].cumsum(axis=0)[::-1]  # beyond each hole
        before = np.broadcast_to([0.0, 0.0, 1.0], directions[0].shape)
        found = np.empty(lengths.shape)
        for d, after in enumerate(directions):
            sine = np.linalg.norm(np.cross(before, after), axis=1)
            angle = np.arctan2(sine, (before * after).sum(axis=1))
            if d or self.plate:
                slides = np.tanh(lost[d] / SLIDES_M)
                tensions = tensions * np.exp(-self.friction * angle * slides)
            found[d], before = tensions, after
        return found

    def _asked(self, bends, tensions):
        """Return the bends (n, 2) that the forces on the shape of some bends ask for."""
        nodes, frames, hinges, middle = self._chain(bends)
        holes, directions, lengths = self._wires(nodes, frames)
        pulls = self._segment_tensions(tensions, directions, lengths)[..., None] * directions
        on_disks = np.zeros((self.disks + 1, len(tensions), 3))
        on_disks[:-1] += pulls
        on_disks[1:] -= pulls
        masses = np.full(self.count + 1, self.arm_mass / self.count)
        masses[[0, -1]] /= 2.0
        masses[-1] += self.tip_mass
        forces = masses[:, None] * np.array([G, 0.0, 0.0])
        forces[:: self.elements] += on_disks.sum(axis=1)
        couples = np.zeros(forces.shape)
        levers = holes - nodes[:: self.elements, None]
        couples[:: self.elements] = np.cross(levers, on_disks).sum(axis=1)
        beyond = forces[::-1].cumsum(axis=0)[::-1][1:]
        moments = (np.cross(nodes, forces) + couples)[::-1].cumsum(axis=0)[::-1][1:]
        own = np.einsum('nij,ni->nj', middle, moments - np.cross(hinges, beyond))
        soft = np.repeat(self.softness or (1.0,) * self.disks, self.elements)[:, None]
        return np.c_[own[:, 1], -own[:, 0]] * soft * (self.length / self.count / self.rigidity)

    def _bends(self, tensions):
        """Repeat with Anderson's acceleration until the bends ask for themselves."""
        bends = np.zeros((self.count, 2))
        tried, left = [], []
        for _ in range(1000):
            off = (self._asked(bends, tensions) - bends).ravel()
            if np.abs(off).max() < SETTLED_RAD:
                return bends
            tried, left = [*tried, bends.ravel()][-HISTORY:], [*left, off][-HISTORY:]
            step = 0.3 * off
            if len(left) > 1:
                moves, changes = np.diff(tried, axis=0).T, np.diff(left, axis=0).T
                weights = np.linalg.lstsq(changes, off, rcond=1e-10)[0]
                step = 0.4 * off - (moves + 0.4 * changes) @ weights
            step *= min(1.0, STEP_MAX_RAD / np.abs(step).max())
            bends = bends + step.reshape(-1, 2)
        raise RuntimeError(f'no equilibrium at {tensions} N')
