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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..exceptions import TendonRobotError

NICE = 5  # control comes first
RESULT, REPORT, BETTER = 'diagnosis.json', 'diagnosis.html', 'better.yaml'


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
        found = []
        while not self._lines.empty():
            found.append(self._lines.get())
        return found

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
        said = self._child.stderr.read().strip().splitlines()
        if self._child.wait():
            why = said[-1] if said else f'ended with code {self._child.returncode}'
            self._lines.put({'kind': 'failed', 'text': why})


def say(kind: str, **values: Any) -> None:
    """Send a line to the parent."""
    print(json.dumps({'kind': kind, **values}), flush=True)


def work(folder: Path, effects: Sequence[str]) -> None:
    """Diagnose, report, and prepare the description with what was found."""
    from ..analysis.add import add_effects
    from ..analysis.diagnose import diagnose
    from ..data import load_dataset
    from ..effects import load_catalogue
    from ..report.diagnosis_text import lines, verdict
    from ..robot_writing import dump_robot

    dataset, catalogue = load_dataset(folder), load_catalogue(effects)

    def progress(what: str, done: int, total: int) -> None:
        say('progress', text=f'{what} {done}/{total}', part=done / max(total, 1))

    found = diagnose(dataset, None, catalogue, 1, progress)
    found.save(folder / RESULT)
    report = _report(found, folder / REPORT)
    say('verdict', sentence=verdict(found), lines=lines(found), report=report,
        diagnosis=found.to_json())  # fmt: skip
    if found.effects:
        say('progress', text='fitting what was found, with its intervals', part=1.0)
        names = [effect.name for effect in found.effects]
        partial = found.verdict == 'outside_catalogue'
        made = add_effects(dataset, names, None, catalogue, None, found.effects, partial=partial)
        (folder / BETTER).write_text(dump_robot(made.robot), encoding='utf-8')
        say('addition', file=str(folder / BETTER), effects=names, partial=partial,
            before=made.check.before, after=made.check.after, floor=made.check.floor)  # fmt: skip
        _illustrate(found, dataset, catalogue, made, folder / REPORT)
    say('done')


def _report(found: Any, path: Path, made: Any = None, pictures: Any = None) -> str:
    """Write the HTML report where the report extra is installed; return its path or ''."""
    if importlib.util.find_spec('plotly') is None:
        return ''
    from ..report.diagnosis_page import write_diagnosis

    write_diagnosis(found, pictures, path, made)
    return str(path)


def _illustrate(found: Any, dataset: Any, catalogue: Any, made: Any, path: Path) -> None:
    """Write the report again, with pictures and with what the addition changes."""
    from ..report.diagnosis_pictures import pictures_of

    _report(found, path, made, pictures_of(found, dataset, catalogue, made.robot))


def main() -> int:
    """Run for the folder and the effect files in the arguments."""
    os.nice(NICE)
    try:
        work(Path(sys.argv[1]), sys.argv[2:])
    except TendonRobotError as error:
        print(' '.join(str(error).split()), file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
