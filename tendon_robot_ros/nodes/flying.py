"""Flights: a path of the tip or of the tendons sent in time, and what came of it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..analysis.flight import Flight
from ..control.path_plan import Pace, Plan, retreat, stretched, thinned
from ..control.playing import Playing
from .incoming import MOST_POINTS
from .pilot import Pilot

Array = NDArray[np.float64]
APPROACH = 60.0  # [s] to the first row at most


def fly_tips(pilot: Pilot, plan: Plan, rate: float) -> Flight:
    """Go to the first row of a plan, then send targets in time, and wait until the arm stands."""
    pilot.clear()
    stamp = pilot.send(*plan.at(0.0))
    pilot.settle(stamp, APPROACH, 'the arm at the first row')
    pilot.stand()
    began = due = time.monotonic()
    sent: list[tuple[float, Array, Array]] = []
    passed = 0.0
    while passed < plan.duration or not sent:
        passed = min(time.monotonic() - began, plan.duration)
        position, direction = plan.at(passed)
        stamp = pilot.send(position, direction)
        view = np.full(3, np.nan) if direction is None else direction
        sent.append((passed, position, view))
        due += 1.0 / rate
        pilot.spin(max(due - time.monotonic(), 0.001))
        pilot.require_good()
    pilot.settle(stamp, APPROACH, 'the arm at the last row')
    pilot.stand()
    sent.append((time.monotonic() - began, *sent[-1][1:]))  # a target stands until the next
    rows = plan.path.times[plan.path.rows].copy()
    rows[-1] = sent[-1][0]  # the last row counts when the arm stands there
    return _flight(pilot, began, sent, rows)


def fly_tendons(pilot: Pilot, times: Array, values: Array, rate: float) -> Flight:
    """Play values (n, m) of the tendons, from where they are; see `stretched` for the rate."""
    pilot.clear()
    here = pilot.commands()[1][-1]
    first = max(float(np.abs(values[0] - here).max()) / rate, 0.05)
    due = stretched(times, values, rate)
    sent = thinned(due, values) if len(due) > MOST_POINTS else np.arange(len(due))
    when = first + due
    began = time.monotonic()
    stamp = pilot.play(Playing(when[sent], values[sent]))
    pilot.settle(stamp, when[-1] + APPROACH, 'the end of the trajectory')
    pilot.stand()
    rows = when.copy()
    rows[-1] = time.monotonic() - began
    return replace(_flight(pilot, began, [], rows), wanted=values)


def fly_back(pilot: Pilot, pace: Pace) -> None:
    """Play the commands since the last `clear` backwards: the arm leaves by the way it came."""
    times, commands = pilot.commands()
    back = retreat(times, commands, pace.pull if pilot.pull else pace.tension)
    pilot.clear()
    stamp = pilot.play(back)
    pilot.settle(stamp, back.times[-1] + APPROACH, 'the arm back where it came from')


def _flight(
    pilot: Pilot, began: float, sent: list[tuple[float, Array, Array]], rows: Array
) -> Flight:
    measured, tip_times, tips, views = pilot.tips()
    command_times, commands = pilot.commands()
    seen, given = tip_times >= began, command_times >= began
    return Flight(
        inputs=pilot.inputs,
        asked_times=np.array([at for at, _, _ in sent]),
        asked=np.array([place for _, place, _ in sent]).reshape(-1, 3),
        asked_directions=np.array([view for _, _, view in sent]).reshape(-1, 3),
        row_times=rows,
        tip_times=tip_times[seen] - began,
        tips=tips[seen],
        tip_directions=views[seen],
        measured=measured,
        command_times=command_times[given] - began,
        commands=commands[given],
        pull=pilot.pull,
    )
