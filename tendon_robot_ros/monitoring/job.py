"""
A diagnosis as a child process, so that no controller waits for it.

The child writes lines of JSON: progress, the verdict, then the description with the added effects.
"""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError, TendonRobotError
from ..common.files import write_text
from ..common.processes import end_with_parent, own_process
from ..common.words import listed, mm, typed
from ..diagnosis.verdict import Verdict

# [1] of POSIX: a third of the processor, so that control comes first
NICENESS = 5
# [1] of the duration of a diagnosis: begin and end of its parts, measured: with 72 postures and 30
# cells; the search for further effects lies between the last two
PARTS = {
    'effects': (0.05, 0.42),
    'effects again': (0.42, 0.6),
    'causes outside the catalogue': (0.6, 0.85),
    'postures left out': (0.87, 1.0),
}
RESULT, REPORT, BETTER = 'diagnosis.json', 'diagnosis.html', 'better.yaml'
IMPROVED = 'improved.yaml'


def send(kind: str, text: str, **values: Any) -> None:
    """Send a line to the parent, with a text for people."""
    print(json.dumps({'kind': kind, 'text': text, **values}), flush=True)


class DiagnosisProgress:
    """Overall progress of a diagnosis and its remaining time, from the progress of its parts."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start the clock."""
        self._clock, self._begin, self._part = clock, clock(), 0.0

    def __call__(self, what: str, done: int, total: int) -> None:
        """Send the progress, which never decreases."""
        if what in PARTS:
            begin, end = PARTS[what]
            self._part = max(self._part, begin + (end - begin) * done / max(total, 1))
        remaining = (self._clock() - self._begin) * (
            1.0 / max(self._part, PARTS['effects'][0]) - 1.0
        )
        duration = f'{remaining / 60.0:.0f} min' if remaining > 90.0 else f'{remaining:.0f} s'
        where = f'{what} {done}/{total} ({100.0 * self._part:.0f} %, about {duration} to go)'
        send('progress', where, part=self._part)


def work(folder: Path, effects: Sequence[str]) -> None:
    """Diagnose, write the report, and prepare the description with the missing effects."""
    from ..data import load_dataset
    from ..diagnosis.add import add_effect
    from ..diagnosis.diagnose import diagnose
    from ..effects import load_catalogue
    from ..report.diagnosis_page import candidate_row
    from ..report.diagnosis_text import lines, verdict
    from ..robot import dump_robot

    dataset, catalogue = load_dataset(folder), load_catalogue(effects)

    diagnosis = diagnose(dataset, None, catalogue, 1, DiagnosisProgress())
    diagnosis.save(folder / RESULT)
    report, sentence = _report(folder / REPORT, diagnosis), verdict(diagnosis)
    send('verdict', sentence, content=diagnosis.to_json() | {
        'sentence': sentence, 'lines': lines(diagnosis), 'report': report,
        'colour': diagnosis.verdict.colour, 'guide': guide_of(diagnosis.verdict, folder),
        'may_add': diagnosis.adds, 'rows': [*map(candidate_row, diagnosis.candidates)],
    })  # fmt: skip
    if diagnosis.effects:
        send('progress', 'fitting what was found, with its intervals', part=1.0)
        names = [effect.name for effect in diagnosis.effects]
        partial = not diagnosis.adds
        addition = add_effect(dataset, diagnosis.effects, None, catalogue, partial=partial)
        write_text(folder / BETTER, dump_robot(addition.robot))
        check = addition.check
        send('addition', f'ready to add {listed(names)}', file=str(folder / BETTER), effects=names,
             partial=partial, before=check.before, after=check.after)  # fmt: skip
        if report:  # once more, with pictures and the error after the addition
            _report(folder / REPORT, diagnosis, dataset, catalogue, addition)


def guide_of(verdict: Verdict, folder: Path) -> str:
    """Return the next step; without a cause in the catalogue some effects may still help."""
    if verdict is not Verdict.OUTSIDE_CATALOGUE:
        return verdict.guide
    command = typed('improve', folder, '--output', folder / IMPROVED)
    return f'{verdict.guide} What lowers the error all the same, effect by effect: {command}'


def _report(path: Path, *shown: Any) -> str:
    """Write the page of a diagnosis where the report extra is installed; return its path or ''."""
    if importlib.util.find_spec('plotly') is None:
        return ''
    from ..report.diagnosis_page import diagnosis_page

    diagnosis_page(*shown).write(path)
    return str(path)


def main() -> int:
    """Run for the folder and the effect files in the arguments."""
    end_with_parent()
    os.nice(NICENESS)
    try:
        work(Path(sys.argv[1]), sys.argv[2:])
    except TendonRobotError as error:
        print(' '.join(str(error).split()), file=sys.stderr)
        return 1
    return 0


class Work:
    """The current or last diagnosis, and the addition that it offers."""

    def __init__(self) -> None:
        """Begin without a diagnosis."""
        self._child: subprocess.Popen[str] | None = None
        self._reader = threading.Thread()
        self._lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._verdict: Verdict | None = None
        self._addition: dict[str, Any] | None = None
        self._sent: dict[str, Any] = {}  # the last addition that went to the controller
        self._requested: bool | None = None  # `partial` of a requested addition
        self.added = 0  # number of descriptions that the controller accepted

    @property
    def running(self) -> bool:
        """Whether a diagnosis runs, or more of its messages are to come."""
        return self._reader.is_alive() or not self._lines.empty()

    @property
    def addition_ready(self) -> str:
        """Effects that `add` would add, '' without any."""
        return '' if self._addition is None else ', '.join(self._addition['effects'])

    def diagnose(self, folder: Path, effects: Sequence[str]) -> None:
        """Start the diagnosis of a data set; it writes into the folder of the data."""
        self.cancel()
        self._verdict, self._addition, self._requested = None, None, None
        lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        # a file takes any amount, a pipe does not; the reader closes it
        complaints = tempfile.TemporaryFile('w+')  # noqa: SIM115
        streams = {'stdin': subprocess.DEVNULL, 'stdout': subprocess.PIPE, 'stderr': complaints}
        child = own_process(__name__, str(folder), *filter(None, effects), **streams)

        def read() -> None:
            assert child.stdout is not None
            for line in child.stdout:
                lines.put(json.loads(line))
            with complaints:
                if child.wait():
                    complaints.seek(0)
                    ended = f'ended with code {child.returncode}'
                    why = (complaints.read().strip().splitlines() or [ended])[-1]
                    lines.put({'kind': 'failed', 'text': f'the diagnosis failed: {why}'})

        self._child, self._lines = child, lines
        self._reader = threading.Thread(target=read, daemon=True)
        self._reader.start()

    def add(self, partial: bool) -> str:
        """
        Request the addition, as soon as its values are fitted.

        Raises
        ------
        InputError
            There is nothing to add.

        """
        if not self._verdict and not self.running:
            raise InputError('nothing to add: call record, then diagnose')
        if self._verdict is Verdict.OUTSIDE_CATALOGUE and not partial:
            raise InputError(
                'nothing was added: the cause is outside the catalogue; the parameter partial '
                'adds what helps all the same'
            )
        if self._verdict and not self.running and self._addition is None:
            raise InputError('nothing to add: the diagnosis found nothing that is missing')
        self._requested = partial
        return 'adding'

    def news(self) -> list[dict[str, Any]]:
        """
        Return the new messages: dictionaries with `kind` and `text`.

        Kind 'verdict' has the `content` to publish, kind 'add' the `file` for the controller.
        """
        news = []
        while not self._lines.empty():
            news.append(item := self._lines.get())
            if item['kind'] == 'verdict':
                self._verdict = Verdict(item['content']['verdict'])
            elif item['kind'] == 'addition':
                self._addition = item
            elif item['kind'] == 'failed':
                self._requested = None
        addition, requested = self._addition, self._requested
        if addition is not None and requested is not None:
            self._requested, self._sent = None, addition
            file = addition['file']
            if addition['partial'] and not requested:
                news.append({'kind': 'refused', 'text': 'nothing was added: see partial'})
            else:
                news.append({'kind': 'add', 'file': file, 'text': f'sending {file}'})
        return news

    def answered(self, accepted: bool, reason: str) -> str:
        """Take the controller's answer to the new description; return it in words."""
        if not accepted:
            return f'the controller refuses the new description: {reason}'
        self.added += 1
        addition = self._sent
        if addition is self._addition:  # else another answer or diagnosis came before this one
            self._addition = self._verdict = None
        errors = f'{mm(addition["before"])} -> {mm(addition["after"])}'
        return f'added {listed(addition["effects"])}: {errors} on postures left out in turn'

    def cancel(self) -> None:
        """Kill the running diagnosis."""
        if self._child is None:
            return
        self._child.kill()  # does nothing to one that has ended
        self._child.wait()
        self._reader.join(timeout=2.0)
        self._child, self._lines = None, queue.SimpleQueue()


if __name__ == '__main__':
    sys.exit(main())
