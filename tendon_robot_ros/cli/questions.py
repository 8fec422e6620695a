"""Questions on a terminal or a pipe; a person is asked again, a pipe gets an error."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TextIO, TypeVar

from ..exceptions import InputError

T = TypeVar('T')


class Questions:
    """Asks one question per line; an empty answer takes the default."""

    def __init__(self, answers: TextIO, prompts: TextIO) -> None:
        """Answers come from one stream, prompts go to another."""
        self._answers, self._prompts = answers, prompts
        self._person = answers.isatty()

    def text(self, question: str, default: str) -> str:
        """Ask for a name."""
        return self._ask(question, default, default, str)

    def whole(self, question: str, default: int, low: int, high: int) -> int:
        """Ask for a whole number within bounds."""

        def read(answer: str) -> int:
            value = int(answer)
            if not low <= value <= high:
                raise ValueError
            return value

        return self._ask(question, str(default), f'a whole number from {low} to {high}', read)

    def number(self, question: str, default: float, low: float, high: float) -> float:
        """Ask for a number within bounds."""

        def read(answer: str) -> float:
            value = float(answer)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError
            return value

        return self._ask(question, f'{default:g}', f'a number from {low:g} to {high:g}', read)

    def choice(self, question: str, known: tuple[str, ...]) -> str:
        """Ask for one of some words; the first is the default."""

        def read(answer: str) -> str:
            if answer not in known:
                raise ValueError
            return answer

        return self._ask(f'{question}: {", ".join(known)}', known[0], ' or '.join(known), read)

    def _ask(self, question: str, default: str, expected: str, read: Callable[[str], T]) -> T:
        while True:
            print(f'{question} [{default}]: ', end='', file=self._prompts, flush=True)
            answer = self._answers.readline().strip()
            if not self._person:
                print(answer, file=self._prompts)
            try:
                return read(answer or default)
            except ValueError:
                message = f'{question}: expected {expected}, got {answer!r}'
                if not self._person:
                    raise InputError(message) from None
                print(message, file=self._prompts)
