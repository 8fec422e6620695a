"""The files of this package, for the tests that read them."""

import ast
import fnmatch
import functools
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# what is made here, by tools and builds
MADE = ('.git', '.venv*', '.*_cache', '.hypothesis', '__pycache__', '*.egg-info')
MADE += ('build', 'generated', 'install', 'log', 'results')


def files(pattern='*'):
    """List the paths of the source tree, relative to its root, that match a pattern."""
    return sorted(path for path in tree() if fnmatch.fnmatch(str(path), pattern))


@functools.cache
def tree():
    """List all paths; once, since tests change nothing there."""
    found = []
    for folder, folders, names in ROOT.walk():
        folders[:] = [n for n in folders if not any(fnmatch.fnmatch(n, made) for made in MADE)]
        found += [(folder / name).relative_to(ROOT) for name in names]
    return found


@functools.cache
def parse(path):
    """Read a module of this package as a syntax tree."""
    return ast.parse((ROOT / path).read_text(encoding='utf-8'), filename=str(path))


def copy_to(folder):
    """Copy the source tree."""
    return Path(shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*MADE)))
