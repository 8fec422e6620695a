"""Which machine a figure was measured on."""

import os
import platform
from pathlib import Path


def machine():
    """Return processor, number of cores and versions, for the JSON of a benchmark."""
    lines = (
        Path('/proc/cpuinfo').read_text().splitlines() if Path('/proc/cpuinfo').exists() else []
    )
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return {
        'host': platform.node(),
        'processor': models[0] if models else platform.processor(),
        'cores': os.cpu_count(),
        'python': platform.python_version(),
    }
