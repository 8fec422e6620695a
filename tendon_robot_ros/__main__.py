"""Run a command: ``python -m tendon_robot_ros <command>``."""

import sys

from .cli.main import main

sys.exit(main())
