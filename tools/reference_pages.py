"""
The pages of the documentation that are made from the code when it is built (docs/conf.py).

Topics and parameters of the nodes, commands, the public names of Python, a gallery, and copies of
pages that lie outside docs/. Those of the effects: effects_page.py.
"""

import contextlib
import io
import math
import os
import re
import sys
from pathlib import Path

import effects_page

import tendon_robot_ros
from tendon_robot_ros.cli.main import COMMANDS, run_command
from tendon_robot_ros.common.words import PROGRAM
from tendon_robot_ros.ros.shared import interface
from tendon_robot_ros.ros.shared.parameters import declared

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / 'docs'
FOLDER = 'generated'  # in docs/, written anew by every build
LINK = re.compile(r'(!?)\[([^\]]*)\]\(([^)\s]+)\)')
FENCED = re.compile(r'(^```.*?^```$)', re.M | re.S)
CONFIGURATIONS = """\
# Configuration files

Examples with every key of a driver's configuration, and of a campaign's plan.
"""
CONFIGURED = (
    *('config/dynamixel_tension.yaml', 'config/dynamixel_pull.yaml', 'config/serial_board.yaml'),
    *('config/ros2_control.yaml', 'config/mock.yaml', 'examples/campaign.yaml'),
)
# what a link of a page means in the built documentation -> its page there
PAGES = {
    'tendon_robot_ros/ros/parameters.yaml': 'ros_parameters',
    'tendon_robot_ros/ros/interface.yaml': 'ros_topics',
    'tendon_robot_ros/effects': 'effects_reference',
    'README.md': 'overview',
    **dict.fromkeys(CONFIGURED, 'configurations'),
    'CONTRIBUTING.md': 'contributing',
    'QUALITY_DECLARATION.md': 'quality',
    **{
        path.relative_to(ROOT).as_posix(): '_'.join(path.relative_to(ROOT).parts[:-1])
        for path in sorted((ROOT / 'data').rglob('README.md'))
    },
}
UNSOUGHT = ('contributing', 'quality')  # in the search they hide what a user looks for
COPIES = {path: name for path, name in PAGES.items() if path.endswith('.md')}
PARAMETERS = """\
# Parameters of the nodes

Those with a * are fixed at the start (`-p NAME:=X` after `--ros-args`, or a file of parameters);
the others can be changed while the node runs (`ros2 param set`). A value outside its range, and a
parameter that the node does not have, are refused. [Topics and services](ros_topics.md).
"""
TABLE = """
## {node}

| parameter | default | unit, range | meaning |
|---|---|---|---|
"""
TOPICS = """\
# Topics, services, actions

Names are relative to the namespace of the robot. All messages are standard ones, in SI units.
[Conventions, examples, quality of service](../ros_interface.md);
[what the statuses say](../ros_nodes.md).

## Topics

| topic | type, quality of service | published by | subscribed by | meaning |
|---|---|---|---|---|
"""
SERVICES = """
## Services

All of type std_srvs/Trigger.

| service | what it does |
|---|---|
"""
ACTIONS = """
## Actions

Offered where the package of the type is installed.

| action | type | goal |
|---|---|---|
"""
COMMAND_PAGE = """\
# Commands

`python -m tendon_robot_ros COMMAND`, or with ROS 2 `ros2 run tendon_robot_ros COMMAND`.
"""
API = """\
# Python API

The names that `tendon_robot_ros` itself has; [From Python](../python.md) shows them at work.

```{{eval-rst}}
.. currentmodule:: tendon_robot_ros

.. autosummary::
   :toctree: api

{names}
```
"""


def write():
    """Write all pages."""
    folder = DOCS / FOLDER
    folder.mkdir(exist_ok=True)
    pages = {
        'ros_parameters': parameters(),
        'ros_topics': topics(),
        'configurations': configurations(),
        'effects_reference': effects_page.reference(),
        'commands': commands(),
        'api': API.format(names='\n'.join(f'   {name}' for name in tendon_robot_ros.__all__)),
        'gallery': gallery(),
    }
    for path, name in COPIES.items():
        text = (ROOT / path).read_text(encoding='utf-8')
        pages[name] = relinked(text, path, FOLDER)
    pages |= {command_file(name): f'# {name}\n\n{said(name)}' for name in COMMANDS}
    for name, text in pages.items():
        unsought = '---\nnosearch: true\n---\n' * (name in UNSOUGHT)
        (folder / f'{name}.md').write_text(unsought + text, encoding='utf-8')
    changes = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    (folder / 'changelog.rst').write_text(f':nosearch:\n\n{changes}', encoding='utf-8')


def relinked(text, path, folder=''):
    """
    Let the links of a page lead to where things are in the built documentation.

    Parameters
    ----------
    text : str
        The page.
    path : str
        Where it lies in the repository.
    folder : str
        Where the built page lies in docs/.

    """

    def link(match):
        image, shown, target = match.groups()
        name, hash_sign, anchor = target.partition('#')
        if re.match(r'[a-z]+:', target) or not name:
            return match[0]
        meant = os.path.normpath(os.path.join(os.path.dirname(path), name))
        if meant in PAGES:
            meant = f'docs/{FOLDER}/{PAGES[meant]}.md'
        elif (ROOT / meant).is_dir():
            return shown
        elif re.fullmatch(r'\w+\.md', shown):  # its name, for who reads the files
            shown = title(ROOT / meant)
        return f'{image}[{shown}]({os.path.relpath(meant, f"docs/{folder}")}{hash_sign}{anchor})'

    parts = FENCED.split(text)
    parts[::2] = [LINK.sub(link, part) for part in parts[::2]]
    return ''.join(parts)


def title(page):
    """Return the first heading of a page."""
    return re.search(r'^# (.+)$', page.read_text(encoding='utf-8'), re.M)[1]


def contents(text):
    """Return the index with its pages as a table of contents, under the words in bold."""
    made = {
        'Start': ['overview'],
        'Reference': [
            'effects_reference',
            'ros_topics',
            'ros_parameters',
            'configurations',
            'commands',
            'api',
            'gallery',
        ],
        'Results': [name for path, name in COPIES.items() if path.startswith('data/')],
        'Change it': ['contributing', 'quality', 'changelog'],
    }
    for part in re.split(r'^\*\*', text, flags=re.M)[1:]:
        caption = part.partition('**')[0]
        pages = [target for _, _, target in LINK.findall(part) if re.fullmatch(r'\w+\.md', target)]
        pages += [f'{FOLDER}/{name}' for name in made.get(caption, ())]
        lines = [':hidden:', f':caption: {caption}', '', *dict.fromkeys(pages)]
        text += '\n```{toctree}\n' + '\n'.join(lines) + '\n```\n'
    return text


def commands():
    """Return the list of commands; each has a page with what its --help-all says."""
    pages = [command_file(name) for name in COMMANDS]
    lines = [f'- [{n}]({page}.md)' for n, page in zip(COMMANDS, pages, strict=True)]
    return '\n'.join([COMMAND_PAGE, *lines, '', '```{toctree}', ':hidden:', '', *pages, '```', ''])


def command_file(name):
    """Return the name of the page of a command."""
    return f'command_{name.replace(" ", "_").replace("-", "_")}'


def said(name):
    """Return the help of a command."""
    first, *rest = name.split()
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
        run_command(first, [*rest, '--help-all'], f'{PROGRAM} {first}')
    return f'```text\n{out.getvalue()}```\n'


def gallery():
    """Return all pictures of the pages, each with the page that explains it."""
    lines = ['# Gallery\n']
    for page in sorted(DOCS.glob('*.md')):
        for image, shown, target in LINK.findall(page.read_text(encoding='utf-8')):
            if image:
                lines.append(f'## [{title(page)}](../{page.name})\n')
                lines.append(f'![{shown}](../{target})\n\n{shown}\n')
    return '\n'.join([*lines, '## [Effects](effects_reference.md)\n', *effects_page.gallery(), ''])


def configurations():
    """Return the page of the configuration files."""
    texts = ((path, (ROOT / path).read_text(encoding='utf-8')) for path in CONFIGURED)
    return CONFIGURATIONS + ''.join(f'\n## {path}\n\n```yaml\n{text}```\n' for path, text in texts)


def topics():
    """Return the page of topics, services and actions."""
    table = interface.declared()
    lines = []
    for name, topic in table['topics'].items():
        sent, heard = (', '.join(topic.get(key, ())) for key in ('from', 'to'))
        kind = f'{topic["type"]}, {topic["quality"]}'
        lines.append(f'| `{name}` | {kind} | {sent} | {heard} | {topic["text"]} |\n')
    services = [f'| `{name}` | {text} |\n' for name, text in table['services'].items()]
    actions = [f'| `{n}` | {a["type"]} | {a["text"]} |\n' for n, a in table['actions'].items()]
    return ''.join([TOPICS, *lines, SERVICES, *services, ACTIONS, *actions])


def parameters():
    """Return the page of the parameters of all nodes."""
    return PARAMETERS + ''.join(
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
    sys.exit(write())
