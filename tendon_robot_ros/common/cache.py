"""Where compiled code is kept, between one process and the next."""

from __future__ import annotations

import os
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path


@cache
def cache_folder() -> Path:
    """Folder for compiled code: NUMBA_CACHE_DIR, XDG_CACHE_HOME, home, else temporary."""
    candidates = [os.environ.get('NUMBA_CACHE_DIR')]
    if os.environ.get('XDG_CACHE_HOME'):
        candidates.append(os.path.join(os.environ['XDG_CACHE_HOME'], 'tendon_robot_ros'))
    elif os.path.expanduser('~') != '~':
        candidates.append(os.path.join(os.path.expanduser('~'), '.cache', 'tendon_robot_ros'))
    for candidate in candidates:
        if not candidate:
            continue
        try:
            path = Path(candidate).resolve()
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                return path
        except OSError:
            continue
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
