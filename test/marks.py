"""Marks of single cases."""

import pytest


def slow(*values):
    """Return a case of parameters that only `make test-slow` runs: others say the same sooner."""
    return pytest.param(*values, marks=pytest.mark.slow)
