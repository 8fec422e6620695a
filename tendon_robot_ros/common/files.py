"""Files and folders that are written whole or not at all; where compiled code is cached."""

from __future__ import annotations

import os
import shutil
import sqlite3
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from .errors import DataSetError, InputError, TendonRobotError

TEXT_ENDINGS = ('.csv', '.txt', '.tsv', '.dat', '.trc')
TABLE_ENDINGS = (*TEXT_ENDINGS, '.parquet', '.c3d')  # of laboratories
YAML_ENDINGS = ('.yaml', '.yml')
PICTURE_ENDINGS = ('.png', '.svg', '.pdf')
PACKAGE = 'tendon_robot_ros'
PATH_MAX = os.pathconf(os.sep, 'PC_PATH_MAX')  # [1] characters; a longer text is no path
DRAFT = '.tmp-'  # how the names of folders begin in which something is made


def read_text(
    path: str | Path, refuse: Callable[[str], TendonRobotError], characters: int = -1
) -> str:
    """
    Return the text of a file; every file that cannot be read is refused alike.

    Parameters
    ----------
    path : str or Path
    refuse : callable
        Makes the error of the reason: there is no such file, it is a folder, no text, ...
    characters : int
        Read so many at most: of a device there is no end. Default: all.

    """
    try:
        with Path(path).open(encoding='utf-8-sig') as file:
            text = file.read(characters)
    except (OSError, ValueError) as error:  # a path may hold a null byte, a file any bytes
        raise refuse(getattr(error, 'strerror', None) or 'not a text file') from None
    if '\0' in text:
        raise refuse('not a text file')
    return text


def named_file(text: str, folder: str = '') -> Path | None:
    """
    Return the file that a text names, None where the text is YAML itself.

    It names one by its path, or by its name where it is shipped in a folder of config/.
    """
    is_yaml = text.lstrip().startswith(('{', '[')) or ': ' in text or '\n' in text
    if is_yaml or not text.strip() or len(text) > PATH_MAX:
        return None
    path = Path(text)
    shipped = None if path.is_file() else shared_file(f'config/{folder}/{text}.yaml')
    return shipped or path


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
    refuse_other_files(shown, replaceable)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=DRAFT, dir=folder.parent))
    except OSError as error:
        raise DataSetError(
            str(shown), f'cannot be written ({error.strerror})', 'name a place where you may write'
        ) from None
    try:
        filled = temporary / folder.name
        filled.mkdir()
        with write_errors(shown):
            yield filled
            refuse_other_files(shown, replaceable)
            old = temporary / f'{folder.name}.old'
            if folder.exists():
                folder.rename(old)
            try:
                filled.rename(folder)
            except OSError:
                if old.exists():
                    old.rename(folder)
                raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def refuse_other_files(folder: Path, replaceable: tuple[str, ...]) -> None:
    """Raise DataSetError if a folder holds anything but replaceable files, or is a file."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise DataSetError(str(folder), 'is a file', 'name a folder')
    for name in sorted(entry.name for entry in folder.iterdir()):
        if name not in replaceable:
            raise DataSetError(
                str(folder), f'is not empty, it holds {name}', 'name a new folder or empty it'
            )


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """
    Give a file to write; when the block ends well, it takes its place at once.

    A link stays a link to what is then written; a device or a pipe, such as /dev/null, is written
    into and stays what it is.
    """
    path = Path(os.path.realpath(path))
    special = path.exists() and not path.is_file() and not path.is_dir()
    if not special and not path.parent.is_dir():
        raise DataSetError(str(path.parent), 'is no folder', 'make it or correct the path')
    folder = None if special else path.parent
    with write_errors(path), tempfile.TemporaryDirectory(prefix=DRAFT, dir=folder) as temporary:
        draft = Path(temporary) / path.name
        yield draft
        if special:
            with draft.open('rb') as source, path.open('wb') as device:
                shutil.copyfileobj(source, device)
        else:
            draft.replace(path)


def write_text(path: str | Path, text: str) -> None:
    """Write a file of text, whole or not at all."""
    with new_file(Path(path)) as draft:
        draft.write_text(text, encoding='utf-8')


def write_picture(figure: Any, path: str | Path, dots: int) -> Path:
    """Write a figure of matplotlib, whole or not at all; the ending says the format."""
    with new_file(Path(path)) as draft:
        figure.savefig(draft, dpi=dots)
    return Path(path)


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Name the destination in errors, such as a full disk, that name none or a temporary file."""
    try:
        yield
    except (OSError, sqlite3.OperationalError) as error:
        named = getattr(error, 'filename', None)
        if named is not None and DRAFT not in str(named):
            raise
        raise DataSetError(
            str(path),
            f'cannot be written ({getattr(error, "strerror", None) or error})',
            'make room there or name another place',
        ) from None


def refuse_ending(option: str, path: str | Path) -> None:
    """Raise InputError where the ending of a picture's name is of no format."""
    if Path(path).suffix not in PICTURE_ENDINGS:
        raise InputError(f'{option} {path}: end the name with {", ".join(PICTURE_ENDINGS)}')


def file_to_write(option: str) -> Callable[[str], str]:
    """
    Return the `type` of an argument that names a file to write.

    Where no file can go there the command ends with InputError before it begins.
    """

    def checked(text: str) -> str:
        path = Path(text).absolute()
        if path.is_dir():
            raise InputError(f'{option} {text}: is a folder; name a file')
        if not path.parent.is_dir():
            raise InputError(f'{text}: its folder does not exist; make it or correct {option}')
        if not os.access(path if path.exists() else path.parent, os.W_OK):
            raise InputError(f'{text}: may not be written; correct {option} or the permissions')
        return text

    return checked


def shared_file(name: str) -> Path | None:
    """
    Find a file or folder that is shipped, such as `config/driver.yaml` or `data/trunk/base`.

    It lies beside the package in a source tree, else in `share/` of the prefix where pip or colcon
    has installed the package.
    """
    above = Path(__file__).resolve().parents[2:]
    roots = [above[0], *(prefix / 'share' / PACKAGE for prefix in above)]
    root = next((root for root in roots if (root / 'package.xml').is_file()), None)
    return root / name if root is not None and (root / name).exists() else None


@cache
def cache_folder() -> Path:
    """Folder for compiled code: NUMBA_CACHE_DIR, XDG_CACHE_HOME, home, else temporary."""
    home = os.path.expanduser('~')
    own = os.environ.get('XDG_CACHE_HOME') or ('' if home == '~' else os.path.join(home, '.cache'))
    folders = os.environ.get('NUMBA_CACHE_DIR'), own and os.path.join(own, PACKAGE)
    for candidate in filter(None, folders):
        with suppress(OSError):
            path = Path(candidate).resolve()
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                return path
    warnings.warn(
        'no writable cache folder: the model is compiled anew by every process; '
        'set NUMBA_CACHE_DIR to a writable folder',
        stacklevel=2,
    )
    return Path(tempfile.mkdtemp(prefix='tendon_robot_ros_'))


def keep_bytecode() -> None:
    """
    Keep compiled Python in `cache_folder()` where it may not be written beside its sources.

    With PYTHONDONTWRITEBYTECODE, which containers set, every node would compile what it imports:
    a second and a half of processor time. Child processes inherit it.
    """
    if sys.dont_write_bytecode and sys.pycache_prefix is None:
        sys.pycache_prefix = os.environ['PYTHONPYCACHEPREFIX'] = str(cache_folder() / 'bytecode')
        sys.dont_write_bytecode = False
        os.environ.pop('PYTHONDONTWRITEBYTECODE', None)
