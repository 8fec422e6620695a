"""Work for the processes of a cluster, in a module that each of them imports at once."""

import os
import time


def nap(number):
    """Return the process that did it, and the number."""
    time.sleep(0.1)
    return os.getpid(), number
