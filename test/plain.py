"""What the values of a status look like."""

import re


def plain_numbers(said):
    """Assert that no number has its unit behind it, and that what has one in its key is one."""
    for key, value in said.items():
        assert not re.fullmatch(r'[-+±]?\d[\d.,e+-]* *(%|°|[A-Za-z°/]+)', value), (key, value)
        if key.endswith(')') and re.search(r' \([^ ]*\)$', key) and value:
            float(value)
