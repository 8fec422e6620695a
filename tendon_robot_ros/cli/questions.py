"""Questions on a terminal or a pipe; a person is asked again, a pipe gets an error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TextIO, TypeVar

from ..common.errors import InputError

T = TypeVar('T')
BACK = ('<', 'back')  # answers that go to the question before
FIRST_WORDS = 'An empty answer takes the value in brackets; < goes back to the question before.'


class _WentBack(Exception):
    """Somebody wants to answer the question before once more."""


class Questions:
    """Asks one question per line; an empty answer takes the default, `<` goes back."""

    def __init__(self, answers: TextIO, prompts: TextIO) -> None:
        """Answers come from one stream, prompts go to another."""
        self._answers, self._prompts = answers, prompts
        self._person = answers.isatty()
        self._given: list[str] = []  # answers, in order
        self._turn = 0  # of the next question
        self._before: dict[str, str] = {}  # question -> what was answered before going back

    def until_answered(self, ask: Callable[[], T]) -> T:
        """Return what `ask` makes of the answers; after a `<` what stays is answered as it was."""
        while True:
            self._turn = 0
            try:
                return ask()
            except _WentBack:
                if self._given:
                    self._given.pop()

    def text(self, question: str, default: str) -> str:
        """Ask for a name."""

        def read(answer: str) -> str:
            if set(',=') & set(answer):
                raise ValueError
            return answer

        return self._ask(question, default, 'a name without comma or equals sign', read)

    def names(self, question: str, known: Sequence[str]) -> list[str]:
        """Ask for as many names as are known, with commas between them."""

        def read(answer: str) -> list[str]:
            names = [name.strip() for name in answer.split(',')]
            if len(set(names)) < len(known) or len(names) != len(known) or '' in names:
                raise ValueError
            if any('=' in name for name in names):
                raise ValueError
            return names

        expected = f'{len(known)} different names with commas between them, none with ='
        return self._ask(question, ','.join(known), expected, read)

    def whole(self, question: str, default: int, low: int, high: int) -> int:
        """Ask for a whole number within bounds."""

        def read(answer: str) -> int:
            value = int(answer)
            if not low <= value <= high:
                raise ValueError
            return value

        return self._ask(question, str(default), f'a whole number from {low} to {high}', read)

    def tell(self, text: str) -> None:
        """Say something before a question, unless that is answered already."""
        if self._turn == len(self._given):
            print(text, file=self._prompts)

    def number(
        self,
        question: str,
        default: float,
        low: float,
        high: float,
        words: Mapping[str, float] = MappingProxyType({}),
        above: bool = False,
        why: str = '',
    ) -> float:
        """Ask for a number within bounds (or above `low`), or for a word that stands for one."""

        def read(answer: str) -> float:
            value = words[answer] if answer in words else float(answer)
            if not low <= value <= high or (above and value == low):
                raise ValueError
            return value

        bounds = f'a number {"above" if above else "from"} {low:g} to {high:g}'
        expected = ' or '.join([f'{bounds} ({why})' if why else bounds, *words])
        return self._ask(question, f'{default:g}', expected, read)

    def choice(self, question: str, known: tuple[str, ...]) -> str:
        """Ask for one of some words; the first is the default."""

        def read(answer: str) -> str:
            return known[known.index(answer)]

        return self._ask(f'{question}: {", ".join(known)}', known[0], ' or '.join(known), read)

    def _ask(self, question: str, default: str, expected: str, read: Callable[[str], T]) -> T:
        self._turn += 1
        if self._turn <= len(self._given):
            return read(self._given[self._turn - 1])
        default = self._before.get(question, default)
        while True:
            print(f'{question} [{default}]: ', end='', file=self._prompts, flush=True)
            answer = self._answers.readline().strip()
            if not self._person:
                print(answer, file=self._prompts)
            if answer in BACK:
                raise _WentBack
            try:
                value = read(answer or default)
            except ValueError:
                message = f'{question}: expected {expected}, got {answer!r}'
                if not self._person:
                    raise InputError(message) from None
                print(message, file=self._prompts)
                continue
            self._given.append(answer or default)
            self._before[question] = answer or default
            return value
