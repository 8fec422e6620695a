"""
Control tendon-driven continuum robots over ROS 2 and find the physics their model lacks.

What a notebook or a script needs has its name here, and is imported when it is asked for:

    from tendon_robot_ros import load_robot, Model, load_dataset, compare, diagnose

`docs/python.md` shows them at work. Other modules are for those who change the package:
`CONTRIBUTING.md` tells the folders, and the first words of each folder its files.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

# Matrices are small here: threads of the linear algebra cost far more than they bring, above all
# on a busy machine. Read when numpy is loaded, so it has to be said before; the user's own stands.
for _library in ('OPENBLAS', 'MKL'):
    os.environ.setdefault(f'{_library}_NUM_THREADS', '1')

if TYPE_CHECKING:
    from .common.errors import TendonRobotError as TendonRobotError
    from .comparison.compare import compare as compare
    from .data import DataSet as DataSet
    from .data import Marker as Marker
    from .data import join as join
    from .data import load_dataset as load_dataset
    from .data import save_dataset as save_dataset
    from .diagnosis.add import add_effect as add_effect
    from .diagnosis.diagnose import diagnose as diagnose
    from .diagnosis.improve import improve as improve
    from .model.model import Model as Model
    from .robot import Robot as Robot
    from .robot import dump_robot as dump_robot
    from .robot import load_robot as load_robot
    from .simulation.measurements import simulate as simulate
    from .simulation.plant import make_plant as make_plant
    from .tables import import_table as import_table
    from .workspace.postures import default_postures as default_postures

# public name -> module of the package that has it
PUBLIC = {
    'DataSet': '.data',
    'Marker': '.data',
    'Model': '.model.model',
    'Robot': '.robot',
    'TendonRobotError': '.common.errors',
    'add_effect': '.diagnosis.add',
    'compare': '.comparison.compare',
    'default_postures': '.workspace.postures',
    'diagnose': '.diagnosis.diagnose',
    'dump_robot': '.robot',
    'import_table': '.tables',
    'improve': '.diagnosis.improve',
    'join': '.data',
    'load_dataset': '.data',
    'load_robot': '.robot',
    'make_plant': '.simulation.plant',
    'save_dataset': '.data',
    'simulate': '.simulation.measurements',
}

__all__ = sorted(PUBLIC)


def __getattr__(name: str) -> Any:
    """Import a public name, or look up the installed version, when it is asked for."""
    if name in PUBLIC:
        return getattr(importlib.import_module(PUBLIC[name], __name__), name)
    if name != '__version__':
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from importlib import metadata  # half of what importing this package would take

    try:
        return metadata.version('tendon_robot_ros')
    except metadata.PackageNotFoundError:  # run from the source tree without an installation
        return 'unknown'


def __dir__() -> list[str]:
    """List the public names, for completion."""
    return [*__all__, '__version__']
