"""What results offer besides their values: words, a table in notebooks, a DataFrame, JSON."""

from __future__ import annotations

import argparse
import importlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from .errors import of_extra
from .files import file_to_write, write_text

# Imported by name when `text` is called, because `report` imports the results.
WORDS = 'tendon_robot_ros.report.in_words'


class TextResult:
    """A result with `text()`, as the command line prints it, and a table in notebooks."""

    def text(self) -> str:
        """Return in words what this is and what follows from it."""
        words = importlib.import_module(WORDS)
        return str(words.text(self))

    def _repr_html_(self) -> str:
        """Return the same as HTML for a notebook, with a table where there is more to see."""
        words = importlib.import_module(WORDS)
        return str(words.html(self))


def pandas() -> Any:
    """Return the package pandas; MissingExtraError where it is not installed."""
    return of_extra('tables', 'pandas')


def arrow() -> Any:
    """Return pyarrow with its Parquet; MissingExtraError where it is not installed."""
    of_extra('tables', 'pyarrow.parquet')
    return of_extra('tables', 'pyarrow')


def make_frame(
    columns: Mapping[str, Any],
    units: Mapping[str, str],
    ordered: Mapping[str, Sequence[str]] | None = None,
) -> Any:
    """
    Return a DataFrame; `frame.attrs['units']` says the units of its columns.

    Columns of names that are `ordered` sort as given: posture 2 before posture 10, and markers
    from the base to the tip.
    """
    package = pandas()
    names = {
        key: package.Categorical(columns[key], dict.fromkeys(known), ordered=True)
        for key, known in (ordered or {}).items()
    }
    frame = package.DataFrame({**columns, **names})
    frame.attrs['units'] = {name: units[name] for name in columns if name in units}
    return frame


def picture_axes(size: tuple[float, float] | None = None, **kind: Any) -> Any:
    """Return axes of a new picture of matplotlib [inch], of a kind as `add_subplot` takes it."""
    from matplotlib import pyplot as plt

    return plt.figure(figsize=size, layout='constrained').add_subplot(**kind)


def plain(value: Any) -> Any:
    """
    Return a value as JSON holds it; a number that is not finite is null.

    Arrays and tuples are lists; an object gives its `to_json()`, or the fields of a dataclass.
    """
    if hasattr(value, 'to_json'):
        return value.to_json()
    if is_dataclass(value):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    if hasattr(value, 'tolist'):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


JSON_OPTION: dict[str, Any] = {
    'type': file_to_write('--json'),
    'nargs': '?',
    'const': '-',
    'metavar': 'OUT',
    'help': 'print the result as JSON instead of the table, or write it to OUT',
}


def narrate(args: argparse.Namespace, text: str) -> None:
    """Print how far a command is, on stderr where stdout is to hold the JSON alone."""
    print(text, file=sys.stderr if args.json == '-' else sys.stdout, flush=True)


def emit(args: argparse.Namespace, content: Any, table: str) -> None:
    """Print the table, or the content as JSON; write the content where --json says."""
    text = json.dumps(content, indent=1, allow_nan=False)
    if args.json == '-':
        print(text, flush=True)
        return
    if args.json is not None:
        write_text(args.json, text + '\n')
    print(table, flush=True)
