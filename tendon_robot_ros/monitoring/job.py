"""
A diagnosis as a child process, so that nothing that controls a robot waits for it.

Lines of JSON come out: progress, the verdict, then the description with what was found.
"""

from __future__ import annotations

import importlib.util
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError, TendonRobotError
from ..common.files import write_text
from ..common.words import PROGRAM, listed, mm
from ..diagnosis.verdict import Verdict

# [1] of POSIX: a third of the processor, so that control comes first
NICENESS = 5
# [1] of the time of a diagnosis, where a part of it begins and ends, measured: of 72 postures and
# 30 cells; the adding of further effects lies between the last two
PARTS = {
    'effects': (0.05, 0.42),
    'effects again': (0.42, 0.6),
    'causes outside the catalogue': (0.6, 0.85),
    'postures left out': (0.87, 1.0),
}
# [1] of it, from which the time to go is worked out; from less it would be off by factors
PART_MIN = 0.02
RESULT, REPORT, BETTER = 'diagnosis.json', 'diagnosis.html', 'better.yaml'
IMPROVED = 'improved.yaml'


class DiagnosisJob:
    """A running diagnosis; `news` gives what it said since the last call."""

    def __init__(self, folder: Path, effects: Sequence[str] = ()) -> None:
        """Start it on a data set; it writes beside the data."""
        self._lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._child = subprocess.Popen(
            [sys.executable, '-m', __name__, str(folder), *effects],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def running(self) -> bool:
        """Whether more may come."""
        return self._reader.is_alive() or not self._lines.empty()

    def news(self) -> list[dict[str, Any]]:
        """Return what came: dictionaries with the key `kind`."""
        news = []
        while not self._lines.empty():
            news.append(self._lines.get())
        return news

    def cancel(self) -> None:
        """End it."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
        self._reader.join(timeout=2.0)

    def _read(self) -> None:
        assert self._child.stdout is not None and self._child.stderr is not None
        for line in self._child.stdout:
            self._lines.put(json.loads(line))
        complaint = self._child.stderr.read().strip().splitlines()
        if self._child.wait():
            why = complaint[-1] if complaint else f'ended with code {self._child.returncode}'
            self._lines.put({'kind': 'failed', 'text': why})


def say(kind: str, **values: Any) -> None:
    """Send a line to the parent."""
    print(json.dumps({'kind': kind, **values}), flush=True)


class Course:
    """How far a diagnosis is as a whole, from what it says of its parts, and how long it takes."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin now."""
        self._clock, self._begin, self._part = clock, clock(), 0.0

    def __call__(self, what: str, done: int, total: int) -> None:
        """Send where it is; it never goes back."""
        if what in PARTS:
            begin, end = PARTS[what]
            self._part = max(self._part, begin + (end - begin) * done / max(total, 1))
        left = (self._clock() - self._begin) * (1.0 / max(self._part, PART_MIN) - 1.0)
        how_long = f'about {left / 60.0:.0f} min' if left > 90.0 else f'about {left:.0f} s'
        where = f'{what} {done}/{total} ({100.0 * self._part:.0f} %, {how_long} to go)'
        say('progress', text=where, part=self._part)


def work(folder: Path, effects: Sequence[str]) -> None:
    """Diagnose, report, and prepare the description with what was found."""
    from ..data import load_dataset
    from ..diagnosis.add import add_effects
    from ..diagnosis.diagnose import diagnose
    from ..effects import load_catalogue
    from ..report.diagnosis_text import lines, verdict
    from ..robot import dump_robot

    dataset, catalogue = load_dataset(folder), load_catalogue(effects)

    diagnosis = diagnose(dataset, None, catalogue, 1, Course())
    diagnosis.save(folder / RESULT)
    report = _report(diagnosis, folder / REPORT)
    say('verdict', content=diagnosis.to_json() | {
        'sentence': verdict(diagnosis), 'lines': lines(diagnosis), 'report': report,
        'colour': diagnosis.verdict.colour, 'guide': guide_of(diagnosis.verdict, folder),
        'may_add': diagnosis.adds,
    })  # fmt: skip
    if diagnosis.effects:
        say('progress', text='fitting what was found, with its intervals', part=1.0)
        names = [effect.name for effect in diagnosis.effects]
        partial = not diagnosis.adds
        made = add_effects(
            dataset, names, None, catalogue, None, diagnosis.effects, partial=partial
        )
        write_text(folder / BETTER, dump_robot(made.robot))
        say('addition', file=str(folder / BETTER), effects=names, partial=partial,
            before=made.check.before, after=made.check.after, floor=made.check.floor)  # fmt: skip
        if report:  # again, with pictures and with what the addition changes
            from ..report.diagnosis_page import pictures_of

            pictures = pictures_of(diagnosis, dataset, catalogue, made.robot)
            _report(diagnosis, folder / REPORT, made, pictures)
    say('done')


def guide_of(verdict: Verdict, folder: Path) -> str:
    """Say what to do next: where no effect is the cause, some together may still help."""
    if verdict is not Verdict.OUTSIDE_CATALOGUE:
        return verdict.guide
    command = f'{PROGRAM} improve {folder} --output {folder / IMPROVED}'
    return f'{verdict.guide} What lowers the error all the same, effect by effect: {command}'


def _report(diagnosis: Any, path: Path, made: Any = None, pictures: Any = None) -> str:
    """Write the HTML report where the report extra is installed; return its path or ''."""
    if importlib.util.find_spec('plotly') is None:
        return ''
    from ..report.diagnosis_page import write_diagnosis

    write_diagnosis(diagnosis, pictures, path, made)
    return str(path)


def main() -> int:
    """Run for the folder and the effect files in the arguments."""
    os.nice(NICENESS)
    try:
        work(Path(sys.argv[1]), sys.argv[2:])
    except TendonRobotError as error:
        print(' '.join(str(error).split()), file=sys.stderr)
        return 1
    return 0


class Work:
    """The diagnosis that runs or ran last, and what it offers to add."""

    def __init__(self) -> None:
        """Begin with none."""
        self._job: DiagnosisJob | None = None
        self._verdict: Verdict | None = None
        self._addition: dict[str, Any] | None = None
        self._wanted: bool | None = None  # add was called; its value: partial, too
        self.added = 0  # so often was a description sent to the controller

    @property
    def running(self) -> bool:
        """Whether a diagnosis runs."""
        return self._job is not None and self._job.running

    @property
    def addition_ready(self) -> str:
        """Effects that `add` would add, '' when there are none."""
        return '' if self._addition is None else ', '.join(self._addition['effects'])

    def diagnose(self, folder: Path, effects: Sequence[str]) -> None:
        """Start a diagnosis."""
        self.cancel()
        self._verdict, self._addition, self._wanted = None, None, None
        self._job = DiagnosisJob(folder, [effect for effect in effects if effect])

    def add(self, partial: bool) -> str:
        """
        Add what was found as soon as its values are there.

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
        self._wanted = partial
        return 'adding'

    def news(self) -> list[dict[str, Any]]:
        """
        Return what happened: dictionaries with `kind` and `text`.

        Kind 'verdict' has the `content` to publish, kind 'add' the `file` for the controller.
        """
        news = [] if self._job is None else self._job.news()
        for item in news:
            item.setdefault('text', '')
            if item['kind'] == 'verdict':
                self._verdict = Verdict(item['content']['verdict'])
                item['text'] = item['content']['sentence']
            elif item['kind'] == 'addition':
                self._addition = item
                item['text'] = f'ready to add {listed(item["effects"])}'
            elif item['kind'] == 'failed':
                self._wanted = None
                item['text'] = f'the diagnosis failed: {item["text"]}'
        return [*news, *self._due()]

    def _due(self) -> list[dict[str, Any]]:
        """Return the addition when it is wanted and there."""
        made, wanted = self._addition, self._wanted
        if made is None or wanted is None:
            return []
        self._wanted = None
        if made['partial'] and not wanted:
            return [{'kind': 'refused', 'text': 'nothing was added: see partial'}]
        return [{'kind': 'add', 'file': made['file'], 'text': f'sending {made["file"]}'}]

    def answered(self, taken: bool, reason: str) -> str:
        """Take what the controller said to the description; return it in words."""
        if not taken:
            return f'the controller refuses the new description: {reason}'
        assert self._addition is not None
        self.added += 1
        made, self._addition, self._verdict = self._addition, None, None
        before, after = mm(made['before']), mm(made['after'])
        return f'added {listed(made["effects"])}: {before} -> {after} on postures left out in turn'

    def cancel(self) -> None:
        """End what runs."""
        if self._job is not None:
            self._job.cancel()
        self._job = None


if __name__ == '__main__':
    sys.exit(main())
