"""The files of this package, for the tests that read them."""

import ast
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NOT_OURS = shutil.ignore_patterns(
    '.*', '__pycache__', '*.egg-info', 'build', 'install', 'log', 'results'
)


def files(*patterns):
    """Paths that git tracks or would track, relative to the root."""
    listed = subprocess.run(
        ['git', 'ls-files', '--cached', '--others', '--exclude-standard', '-z', '--', *patterns],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    return [Path(name) for name in listed.split('\0') if name and (ROOT / name).is_file()]


def parse(path):
    """Read a module of this package as a syntax tree."""
    return ast.parse((ROOT / path).read_text(encoding='utf-8'), filename=str(path))


def copy_to(folder):
    """Copy the package, without environments and builds."""
    return Path(shutil.copytree(ROOT, folder, ignore=NOT_OURS))
