"""Content of the live page, from the topics."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...common.arrays import Floats
from ...common.words import listed, mm
from ..shared.timing import ANSWER_TIMEOUT_S, SILENCE_S

# [s] between two points of the curve and two updates of the panel, because nobody reads faster
PANEL_PERIOD_S = 0.2
# [s] over which displayed numbers are medians, so that they can be read
STEADY_S = 1.5
# [s] shown by the curve, so that it covers a recording of a dozen postures
CURVE_SPAN_S = 120.0
# [1] postures for a diagnosis, else several effects would explain them equally well
POSTURES_ADVISED = 8
CHANGED_HINT = 'Click Investigate: it goes to the postures that tell what has changed.'
COINCIDE = (
    'The model now has {}. The two arms should coincide; what is left of the error is noise.'
)
RECORD_HINT = 'Click 1 to record again.'
LEVEL_NAMES = 'ok', 'warn', 'error', 'silent'  # by the numbers of DiagnosticStatus


@dataclass
class ViewState:
    """The last messages of all topics; times are monotonic [s]."""

    inputs: tuple[str, ...] = ()
    tensions: tuple[float, ...] = ()
    limits: tuple[float, float] = (0.0, 5.0)  # [N]
    measured: Floats = field(default_factory=lambda: np.zeros((0, 3)))  # (J, 3) [m]
    predicted: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    force: Floats = field(default_factory=lambda: np.zeros((2, 3)))  # [m] arrow of what pushes
    force_at: float = -np.inf
    marker_errors: deque[tuple[float, Floats]] = field(default_factory=deque)  # [s], (J,) [m]
    curve: deque[tuple[float, float]] = field(  # [s], rolling error [m]
        default_factory=lambda: deque(maxlen=round(CURVE_SPAN_S / PANEL_PERIOD_S) + 1)
    )
    marks: list[tuple[float, str]] = field(default_factory=list)
    verdict: dict[str, Any] = field(default_factory=dict)
    progress: str = ''
    investigation: list[dict[str, Any]] = field(default_factory=list)  # its messages, oldest first
    touring: bool = True
    held: bool = False  # the target is or was dragged
    nodes: dict[str, tuple[float, str, str, dict[str, str]]] = field(default_factory=dict)

    def node(self, name: str) -> tuple[float, str, str, dict[str, str]]:
        """Return when the last status of a node came [s], its level, sentence and values."""
        return self.nodes.get(name, (-np.inf, '', '', {}))

    @property
    def monitor(self) -> dict[str, str]:
        """Values of the monitor's status."""
        return self.node('monitor')[3]

    @property
    def recording(self) -> bool:
        """Whether postures are recorded."""
        return self.monitor.get('recording') == 'true'

    @property
    def postures(self) -> int:
        """Number of recorded postures."""
        return int(self.monitor.get('postures', '0'))

    @property
    def paused(self) -> bool:
        """Whether a recording was stopped and is not diagnosed yet: record continues it."""
        return self.monitor.get('kept') == 'false' and not self.recording and self.postures > 0

    @property
    def record_label(self) -> str:
        """Label of the first button: the effect of a click."""
        if self.recording:
            return f'1  Stop recording ({self.postures})'
        return f'1  Record on, from {self.postures}' if self.paused else '1  Record'

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        values = [values for *_, values in self.nodes.values()]
        return any(v.get('stopped') == 'true' or v.get('code') == 'stopped' for v in values)

    @property
    def ready(self) -> dict[str, bool]:
        """Name of a button -> whether a click on it does something now."""
        monitor = self.monitor
        free = monitor.get('diagnosing') != 'true'  # else a diagnosis uses the recording
        return {
            'record': free,
            'diagnose': free and self.postures >= 2,
            'add': bool(monitor.get('addition')) and self.verdict.get('may_add') is not False,
            'start': self.node('investigate')[3].get('code') == 'waiting',
        }

    def set_status(
        self, now: float, name: str, level: int, text: str, values: dict[str, str]
    ) -> None:
        """Update the status of a node."""
        known, before = LEVEL_NAMES[level] if level < len(LEVEL_NAMES) else 'warn', self.monitor
        self.nodes[name] = now, known, text, values
        if name == 'monitor':
            if values.get('diagnosing') == 'true' and before.get('diagnosing') != 'true':
                self.verdict = {}
            if int(values.get('added', '0')) > int(before.get('added', '0')):
                self.marks.append((now, before.get('addition', '')))

    def add_error(self, now: float, rolling: float) -> None:
        """Append a rolling error [m] to the curve."""
        if not self.curve or now - self.curve[-1][0] >= PANEL_PERIOD_S:
            self.curve.append((now, rolling))

    def add_marker_errors(self, now: float, errors: Sequence[float]) -> None:
        """Append the errors (J,) [m] of the markers; those of the last `STEADY_S` are kept."""
        self.marker_errors.append((now, np.array(errors, dtype=float)))
        while now - self.marker_errors[0][0] > STEADY_S:
            self.marker_errors.popleft()

    def add_investigation(self, text: str) -> None:
        """Append a message of an investigation; a change or posture 1 starts a new one."""
        news = json.loads(text)
        last = self.investigation[-1]['kind'] if self.investigation else ''
        first = news['kind'] == 'posture' and news.get('number') == 1 and last != 'change'
        if first or (news['kind'] == 'change' and news['postures'] == 0):
            self.investigation.clear()
            self.verdict = {}  # of an earlier recording
        self.investigation.append(news)

    def rolling(self, now: float) -> float:
        """Return the median rolling error [m] of the last `STEADY_S`; nan: there is none."""
        recent = [e for at, e in self.curve if now - at < STEADY_S and np.isfinite(e)]
        return float(np.median(recent)) if recent else float('nan')

    def errors(self) -> Floats:
        """Return error vectors as segments (J, 2, 3) [m] from predicted to measured."""
        measured, predicted = self.measured, self.predicted
        if len(measured) != len(predicted):
            return np.zeros((0, 2, 3))
        unseen = ~np.isfinite(measured).all(axis=1)
        return np.stack([predicted, np.where(unseen[:, None], predicted, measured)], axis=1)

    def force_line(self, now: float) -> Floats:
        """Return an arrow of the force as segments (1, 2, 3) [m], of no length if it is old."""
        return self.force[None] if now - self.force_at <= SILENCE_S else np.zeros((1, 2, 3))

    def per_marker(self) -> str:
        """Return the marker with the largest median error of the last `STEADY_S`, as text."""
        samples = [one for _, one in self.marker_errors]
        errors = np.array([one for one in samples if len(one) == len(samples[-1])])
        visible = np.isfinite(errors).any(axis=0) if len(errors) else np.zeros(0, dtype=bool)
        if not visible.any():
            return ''
        sizes = np.full(len(visible), np.nan)
        sizes[visible] = np.nanmedian(errors[:, visible], axis=0)
        worst = int(np.nanargmax(sizes))
        place = 'the tip' if worst == len(sizes) - 1 else f'marker {worst + 1} of {len(sizes)}'
        return f'most at {place}: {mm(float(sizes[worst]), 2)}'

    def statuses(self, now: float) -> dict[str, tuple[str, str]]:
        """Return name -> (level, sentence) of the nodes; old ones have the level silent."""
        texts = {}
        for name in ('controller', 'driver', 'monitor'):
            at, level, text, _ = self.node(name)
            texts[name] = (level, text) if now - at < ANSWER_TIMEOUT_S else ('silent', 'not heard')
        return texts

    def guide(self) -> str:
        """Return the next step, in the words of the buttons."""
        if self.monitor.get('diagnosing') == 'true' and not self.verdict:
            return 'Comparing every known physical effect with the recording …'
        if self.recording and self.postures < POSTURES_ADVISED:
            return (
                f'Recording: {self.postures} of {POSTURES_ADVISED} postures. '
                'The arm goes through them by itself: just wait.'
            )
        if self.recording or self.paused:
            also = '1 stops' if self.recording else '1 records more'
            return (
                f'{self.postures} postures are recorded. Click 2: which effect is missing? '
                f'({also}; {POSTURES_ADVISED} suffice, with more a diagnosis takes longer.)'
            )
        if self.ready['add']:
            return str(self.verdict.get('guide', 'Click 3: the model gets the effect.'))
        investigated = any(news['kind'] == 'change' for news in self.investigation)
        if self.monitor.get('drift') == 'true' and self.ready['start'] and not investigated:
            return f'The arm is {self.monitor.get("watch", "")}. {CHANGED_HINT}'
        if self.investigation and not self.verdict:
            return self._investigation_guide()
        if self.marks:
            return f'{COINCIDE.format(self.marks[-1][1])} Click 1 to look for more.'
        if self.monitor.get('diagnosing') == 'true':
            return 'Fitting what was found …'
        if self.verdict:
            fell_through = self.verdict.get('may_add', True)  # an effect was found, and not added
            return RECORD_HINT if fell_through else str(self.verdict.get('guide'))
        if not self.curve:
            return 'Waiting for the robot. What the nodes say is at the bottom.'
        return (
            'The measured arm is not where the model predicts it? Some physical effect is missing '
            'in the model. Find it: click 1 to record some postures.'
        )

    def _investigation_guide(self) -> str:
        """Return the state of the investigation, and the next step at its end."""
        last = self.investigation[-1]
        ends = [news for news in self.investigation if news['kind'] == 'end']
        sent = any(one['kind'] == 'sent' and one['taken'] for one in self.investigation)
        if last['kind'] == 'failed':
            hint = 'Click Investigate to begin again.'
            return f'The investigation ended: {last["text"]}. {hint}'
        if not ends:
            return 'The arm chooses its postures by itself: just wait. STOP ends it.'
        if not sent:
            after = 'Its report is in the folder of the investigation.'
            return f'The investigation is over after {ends[-1]["text"].strip()}. {after}'
        return COINCIDE.format(listed(ends[-1]['names']))
