"""Reading a configuration from a path, from the name of a shipped file, or from text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...common.errors import InputError
from ...common.files import read_text, shared_file
from ...common.yaml_reading import parse_yaml
from ...robot.description import DESCRIPTION_MAX


def read_mapping(text: str, what: str) -> dict[str, Any]:
    """Read a configuration: a path, the name of a file in config, or YAML text; '' is empty."""
    if text.strip() and '\n' not in text and ':' not in text:
        own = None if Path(text).is_file() else shared_file(f'config/{text}.yaml')
        path = own or Path(text)

        def refuse(reason: str) -> InputError:
            return InputError(f'{what}: {path}: {reason}; expected a YAML file or text')

        text = read_text(path, refuse, DESCRIPTION_MAX + 1)
    if len(text) > DESCRIPTION_MAX:
        raise InputError(
            f'{what}: expected at most {DESCRIPTION_MAX:,} characters, got more than that'
        )
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise InputError(f'{what}: not valid YAML: {error}') from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f'{what}: expected keys with values, got {content!r}')
    return content
