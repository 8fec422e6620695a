"""
Print a script that completes commands, options and files in bash; in zsh after `bashcompinit`.

It is for the executable `tendon_robot_ros` that pip installs. bash loads it when it lies in
~/.local/share/bash-completion/completions/tendon_robot_ros.

example: python -m tendon_robot_ros completion
"""

from __future__ import annotations

import argparse
from contextlib import suppress

HELP = 'print a script that completes commands and options in the shell'
SCRIPT = """\
_tendon_robot_ros() {{
    local known typed="${{COMP_WORDS[*]:1:COMP_CWORD-1}} "
    case "${{typed# }}" in
{cases}
    esac
    COMPREPLY=($(compgen -W "$known" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _tendon_robot_ros tendon_robot_ros"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare nothing."""


def run(args: argparse.Namespace) -> None:
    """Print the script."""
    from .main import COMMANDS, GROUPS, WORDS

    cases = [
        f"    '{name} '*) known='{' '.join(options_of(place))}';;"
        for name, place in COMMANDS.items()
    ]
    for group in GROUPS:
        members = ' '.join(second for first, _, second in WORDS if first == group)
        cases.append(f"    '{group} ') known='{members}';;")
    first = ' '.join(dict.fromkeys(first for first, _, _ in WORDS))
    print(SCRIPT.format(cases='\n'.join([*cases, f"    '') known='{first}';;"])))


def options_of(place: str) -> list[str]:
    """Return the options of a command; of a node that cannot be imported here, those of all."""
    from .main import Parser, command_of

    parser = Parser(prog='', description='')
    with suppress(ImportError, AttributeError):  # without ROS; a node that takes parameters only
        command_of(place).add_arguments(parser)
    ros = ['--ros-args'] if '.ros.' in place else []
    return sorted({o for o in parser._option_string_actions if o.startswith('--')}) + ros
