"""Which machine a figure was measured on, and how figures are told."""

import json
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


def stolen():
    """Return how long [s] other machines of the same computer have had this one's processors."""
    stat = Path('/proc/stat')
    fields = stat.read_text().split('\n', 1)[0].split() if stat.exists() else []
    return int(fields[8]) / os.sysconf('SC_CLK_TCK') if len(fields) > 8 else 0.0


def tell(figures, file=None):
    """Print figures as JSON, and write them to a file where one is named."""
    text = json.dumps(figures, indent=1)
    print(text)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + '\n')
