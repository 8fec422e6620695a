"""
How often the 95 % intervals of `add` hold: every effect on two robots, other noise every time.

The simulated robots are those of the model (same cells, same friction law), so that only the
noise can push a true value out of its interval.
"""

import sys

from planned import parser_of, run


def main() -> int:
    """Fit everything and print the coverage."""
    return run('intervals', parser_of(__doc__, 200).parse_args())


if __name__ == '__main__':
    sys.exit(main())
