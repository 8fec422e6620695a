"""From a recording to a better description: what runs, what was found, what was added."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..exceptions import InputError
from ..report.words import listed, mm
from .job import DiagnosisJob


class Work:
    """The diagnosis that runs or ran last, and what it offers to add."""

    def __init__(self) -> None:
        """Begin with none."""
        self._job: DiagnosisJob | None = None
        self._verdict = ''
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
        self._verdict, self._addition, self._wanted = '', None, None
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
        if self._verdict == 'outside_catalogue' and not partial:
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

        Kind 'add' has the `file` to send to the controller.
        """
        found = [] if self._job is None else self._job.news()
        for item in found:
            item.setdefault('text', '')
            if item['kind'] == 'verdict':
                self._verdict = item['diagnosis']['verdict']
                item['text'] = item['sentence']
            elif item['kind'] == 'addition':
                self._addition = item
                item['text'] = f'ready to add {listed(item["effects"])}'
            elif item['kind'] == 'failed':
                self._wanted = None
                item['text'] = f'the diagnosis failed: {item["text"]}'
        return [*found, *self._due()]

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
        made, self._addition, self._verdict = self._addition, None, ''
        before, after = mm(made['before']), mm(made['after'])
        return f'added {listed(made["effects"])}: {before} -> {after} on postures left out in turn'

    def cancel(self) -> None:
        """End what runs."""
        if self._job is not None:
            self._job.cancel()
        self._job = None
