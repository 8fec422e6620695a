"""Files and folders that are there whole, or not at all."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import DataSetError, InputError

TEXT_ENDINGS = ('.csv', '.txt', '.tsv', '.dat', '.trc')
TABLE_ENDINGS = (*TEXT_ENDINGS, '.parquet', '.c3d')  # of laboratories
YAML_ENDINGS = ('.yaml', '.yml')
PICTURE_ENDINGS = ('.png', '.svg', '.pdf')
PACKAGE = 'tendon_robot_ros'


@contextmanager
def new_folder(folder: Path, replaceable: tuple[str, ...] = ()) -> Iterator[Path]:
    """
    Give a folder to fill; when the block ends well, it takes its place at once.

    Parameters
    ----------
    folder : Path
        Where it goes: a new or empty folder.
    replaceable : tuple of str
        Replace a folder that holds nothing but files of these names.

    Raises
    ------
    DataSetError
        Something else is there, or nothing can be written there.

    """
    shown, folder = folder, Path(os.path.abspath(folder))  # '.' and 'name/..' have no parent
    _check(shown, replaceable)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f'.{folder.name}-', dir=folder.parent))
    except OSError as error:
        raise DataSetError(
            str(shown),
            f'cannot be written ({error.strerror})',
            'name a place where you may write',
        ) from None
    try:
        filled = temporary / folder.name
        filled.mkdir()
        yield filled
        _check(shown, replaceable)
        _replace(folder, filled, temporary / f'{folder.name}.old')
    except OSError as error:
        raise DataSetError(
            str(shown),
            f'cannot be written ({error.strerror})',
            'make room there or name another place',
        ) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """
    Give a file to write; when the block ends well, it takes its place at once.

    A link stays a link to what is then written; a device or a pipe, such as /dev/null, is written
    into and stays what it is.
    """
    path = Path(os.path.realpath(path))
    special = path.exists() and not path.is_file() and not path.is_dir()
    folder = None if special else _parent(path)
    with _told(path), tempfile.TemporaryDirectory(prefix='.tmp-', dir=folder) as temporary:
        draft = Path(temporary) / path.name
        yield draft
        if special:
            with draft.open('rb') as made, path.open('wb') as device:
                shutil.copyfileobj(made, device)
        else:
            draft.replace(path)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Name the file in an error of the system that names none, or the draft: a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is not None and '.tmp-' not in str(error.filename):
            raise
        raise DataSetError(
            str(path),
            f'cannot be written ({error.strerror or error})',
            'make room there or name another place',
        ) from None


def _replace(folder: Path, filled: Path, old: Path) -> None:
    if folder.exists():
        folder.rename(old)
    try:
        filled.rename(folder)
    except OSError:
        if old.exists():
            old.rename(folder)
        raise


def _parent(path: Path) -> Path:
    if not path.parent.is_dir():
        raise DataSetError(str(path.parent), 'is no folder', 'make it or correct the path')
    return path.parent


def _check(folder: Path, replaceable: tuple[str, ...]) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise DataSetError(str(folder), 'is a file', 'name a folder')
    for name in sorted(entry.name for entry in folder.iterdir()):
        if name not in replaceable:
            raise DataSetError(
                str(folder), f'is not empty, it holds {name}', 'name a new folder or empty it'
            )


def refuse_ending(option: str, path: str | Path) -> None:
    """Raise InputError where the ending of a picture's name is of no format."""
    if Path(path).suffix not in PICTURE_ENDINGS:
        raise InputError(f'{option} {path}: end the name with {", ".join(PICTURE_ENDINGS)}')


def shared_file(name: str) -> Path | None:
    """
    Find a file such as `config/driver.yaml`.

    Looks in a source tree first, then where pip and colcon install shared files.
    """
    roots = [Path(__file__).resolve().parents[2]]
    prefixes = [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
    roots += [Path(prefix) / 'share' / PACKAGE for prefix in prefixes if prefix]
    return next((root / name for root in roots if (root / name).is_file()), None)
