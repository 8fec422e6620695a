"""
How often the diagnosis is right: every effect, two robots, sizes from a fifteenth to full.

Plants are of another discretisation: arcs of three finer cells, hinges, the capstan's exponential;
`--scatter 0.02` adds scatter of the cells' stiffness, which `--declare` declares as a tolerance.
"""

from __future__ import annotations

import sys

from planned import parser_of, run


def main() -> int:
    """Judge all cases on all cores."""
    parser = parser_of(__doc__, 20)
    parser.add_argument('--clean', type=int, default=300, help='of both robots')
    parser.add_argument('--scatter', type=float, default=0.0)
    parser.add_argument('--declare', action='store_true', help='the description knows the scatter')
    level = 'build arms with imperfections'
    parser.add_argument('--as-built', type=float, default=0.0, metavar='LEVEL', help=level)
    parser.add_argument('--exact', action='store_true', help='descriptions say exact: true')
    options = parser.parse_args()
    return run(
        'diagnosis',
        options,
        clean=options.clean // 2,
        imperfections=[options.as_built],
        scatter=options.scatter,
        declared=options.declare,
        exact=options.exact,
    )


if __name__ == '__main__':
    sys.exit(main())
