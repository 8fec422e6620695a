"""
The commands, links and paths in the documents: how they are found, and how they are run.

In a ```console block every line that begins with `$ ` is a command (a backslash at its end
continues it), all other lines show output. ```python blocks run as they stand. They, and blocks
that only call this package, are forked (forked.py), others run in a shell. The blocks of a page
share one folder, so that a later one finds the files of an earlier one; it holds links to
config/, data/ and examples/, and `python` is the one that runs the tests. The line before a block
may say

    <!-- not run: the reason -->
    <!-- slow -->                               only `make test-slow` runs it
    <!-- each in a terminal of its own -->      commands that go on until the section ends

What a page shows below a command, the command must print; `...` stands for anything. What such a
terminal shows must appear before the next command is typed.
"""

import os
import re
import shlex
import signal
import sys
import time
from pathlib import Path

import processes
from forked import Forked
from source_tree import ROOT, files

BLOCK = re.compile(
    r'^(?:<!-- (?:not run: (?P<reason>[^\n]+)|(?P<slow>slow)'
    r'|(?P<stays>each in a terminal of its own)) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$',
    re.M | re.S,
)
COMMAND = re.compile(r'^\$ ((?:[^\n]*\\\n)*[^\n]*)$', re.M)
CALLED = ['python', '-m', 'tendon_robot_ros']
SHELL = re.compile(r'[|;&$`>*?~(]')  # what only a shell understands
SHELLS = {'bash', 'sh', 'shell', 'zsh'}
PAGES = [
    page
    for pattern in ('README.md', 'CONTRIBUTING.md', 'QUALITY_*.md', 'docs/*.md', 'data/*.md')
    for page in files(pattern)
]


def text_of(page):
    """Read a page."""
    return (ROOT / page).read_text(encoding='utf-8')


def blocks(text):
    """Return the fenced blocks of a text."""
    return [match.groupdict() for match in BLOCK.finditer(text)]


def commands(text):
    """Return the commands of a console block as one script that stops at the first failure."""
    return '\n'.join(['set -e', *COMMAND.findall(text)])


def typed(text):
    """Yield each command of a console block with the lines shown after it."""
    for part in re.split(r'^(?=\$ )', text, flags=re.M):
        if command := COMMAND.match(part):
            shown = part[command.end() :].splitlines()
            yield command[1], [line for line in shown if line.strip()]


def is_live(text):
    """Tell whether something keeps running on a page."""
    return any(block['stays'] for block in blocks(text))


def prepare(folder):
    """Put links to what the commands of a page use into a folder."""
    for name in ('config', 'data', 'examples'):
        (folder / name).symlink_to(ROOT / name)
    return folder


def environment():
    """Return the environment in which a reader types."""
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'
    return os.environ | {'PATH': path, 'PYTHONPATH': str(ROOT), 'PYTHONUNBUFFERED': '1'}


def calls_of_the_package(block):
    """Return arguments and input of every call, None where something else stands in the block."""
    found = []
    for command in COMMAND.findall(block['text']):
        words = shlex.split(command.replace('\\\n', ' '), comments=True)
        given = words[words.index('<') + 1 :] if '<' in words else []
        if words[:3] != CALLED or len(given) > 1 or SHELL.search(command):
            return None
        found.append((words[3 : len(words) - 2 * len(given)], *given))
    return found


def run(block, folder, timeout=120):
    """Run a console or python block and refuse a failure; calls of the package are forked."""
    calls = calls_of_the_package(block) if block['language'] == 'console' else None
    if calls:
        return ''.join(run_forked(*call, folder=folder, timeout=timeout) for call in calls)
    if block['language'] == 'python':
        return run_forked(['-c', block['text']], folder=folder, timeout=timeout)
    call = ['bash', '-c', commands(block['text'])]
    result = processes.run(call, cwd=folder, env=environment(), timeout=timeout)
    assert result.returncode == 0, f'{block["text"]}\n{result.stdout}{result.stderr}'
    return result.stdout


def run_forked(arguments, given=os.devnull, *, folder, timeout):
    """Run a command of the package, or lines of Python, in a folder with a file as input."""
    pipes = {'stdout': processes.PIPE, 'stderr': processes.PIPE}
    with (
        (folder / given).open() as file,
        Forked(arguments, stdin=file, cwd=folder, env=environment(), **pipes) as process,
    ):
        out, err = process.communicate(timeout=timeout)
    assert process.returncode == 0, f'{arguments}\n{out}{err}'
    return out


def runs(block, slow):
    """Tell whether a block is one to run."""
    if block['reason'] or block['language'] not in ('console', 'python'):
        return False
    return slow or not block['slow']


def appears(line, printed):
    """Tell whether a line that a page shows is printed; `...` stands for anything."""
    parts = [re.escape(' '.join(part.split())) for part in line.split('...')]
    pattern = re.compile(r'\s*.*?\s*'.join(parts))
    return any(pattern.fullmatch(' '.join(found.split())) for found in printed.splitlines())


class Terminal:
    """A command that goes on, in a terminal of its own."""

    def __init__(self, command, folder, number):
        self.command, self.log = command, folder / f'terminal_{number}.txt'
        with self.log.open('w') as output:
            self.process = processes.Process(
                ['bash', '-c', f'exec {command}'],
                cwd=folder,
                env=environment(),
                stdin=processes.PIPE,
                stdout=output,
                stderr=processes.STDOUT,
            )

    def wait_for(self, lines, timeout=120.0):
        """Wait until every shown line has appeared."""
        end = time.monotonic() + timeout
        while not all(appears(line, printed := self.log.read_text()) for line in lines):
            assert self.process.poll() is None, f'{self.command}\nended:\n{printed}'
            assert time.monotonic() < end, f'{self.command}\nshows no {lines}:\n{printed}'
            time.sleep(0.1)

    def end(self):
        """Press Ctrl-C; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(20.0)
        except processes.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


def run_live(text, folder, slow=False):
    """Run a page in which commands keep running until their section ends."""
    for body in re.split(r'^## .+\n', text, flags=re.M):
        terminals = []
        try:
            for block in blocks(body):
                if block['stays']:
                    for command, lines in typed(block['text']):
                        terminals.append(Terminal(command, folder, len(terminals)))
                        terminals[-1].wait_for(lines)
                elif runs(block, slow):
                    shows(block, run(block, folder))
        finally:
            codes = [terminal.end() for terminal in reversed(terminals)]
        assert set(codes) <= {0}, f'{[t.command for t in reversed(terminals)]}: {codes}'


def shows(block, printed):
    """Refuse a console block that shows what its commands do not print."""
    if block['language'] != 'console':
        return
    lines = [line for _, lines in typed(block['text']) for line in lines]
    missing = [line for line in lines if not appears(line, printed)]
    assert not missing, f'{block["text"]}\nprints\n{printed}'
