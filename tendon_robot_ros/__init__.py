"""Control tendon-driven continuum robots over ROS 2 and find the physics their model lacks."""

from __future__ import annotations

from importlib import metadata


def __getattr__(name: str) -> str:
    """Look up the installed version when it is asked for; package.xml is its only source."""
    if name != '__version__':
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    try:
        return metadata.version('tendon_robot_ros')
    except metadata.PackageNotFoundError:  # run from the source tree without an installation
        return 'unknown'
