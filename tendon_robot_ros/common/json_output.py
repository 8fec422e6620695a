"""The option --json of a command, and what it prints or writes."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from .files import file_to_write, write_text

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
