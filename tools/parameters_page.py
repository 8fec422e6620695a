"""
Write docs/ros_parameters.md from the table of the nodes' parameters (ros/parameters.yaml).

python tools/parameters_page.py

test/test_docs_ros_interface.py compares the two.
"""

import math
import sys
from pathlib import Path

from tendon_robot_ros.ros.shared.parameters import declared

PAGE = Path(__file__).parent.parent / 'docs' / 'ros_parameters.md'
HEAD = """\
# Parameters of the nodes

Written by `tools/parameters_page.py`. Those with a * are fixed at the start (`-p NAME:=X` after
`--ros-args`, or a file of parameters); the others can be changed while the node runs
(`ros2 param set`). A value outside its range, and a parameter that the node does not have, are
refused. Topics and services: [ros_nodes.md](ros_nodes.md).
"""
TABLE = """
## {node}

| parameter | default | unit, range | meaning |
|---|---|---|---|
"""


def main():
    """Write the page."""
    PAGE.write_text(page(), encoding='utf-8')
    return 0


def page():
    """Return the page as the parameters are now."""
    return HEAD + ''.join(
        TABLE.format(node=node.replace('_', '-')) + ''.join(map(row, specs.values()))
        for node, specs in declared().items()
    )


def row(spec):
    """Write the line of a parameter."""
    limits = f'{spec.low:g} to {spec.high:g}' if math.isfinite(spec.low) else ''
    known = ', '.join(filter(None, [spec.unit, limits, *spec.choices]))
    name = f'`{spec.name}`' + '*' * spec.read_only
    text = spec.text.replace('<', '&lt;')
    return f'| {name} | {shown(spec.default)} | {known} | {text} |\n'


def shown(default):
    """Write a default as YAML does, no text as nothing."""
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, list):
        return '[]'
    return f'{default:g}' if isinstance(default, float) else default


if __name__ == '__main__':
    sys.exit(main())
