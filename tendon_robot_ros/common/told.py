"""Results that say themselves: in words, and in a notebook."""

from __future__ import annotations

import importlib

# By its name: the words import the results, and are needed by who asks for them only.
WORDS = 'tendon_robot_ros.report.in_words'


class Told:
    """A result with `text()`, what the command line prints, and a table in notebooks."""

    def text(self) -> str:
        """Say in words what this is and what follows from it."""
        words = importlib.import_module(WORDS)
        return str(words.text(self))

    def _repr_html_(self) -> str:
        """Show the same in a notebook, with a table where there is more to see."""
        words = importlib.import_module(WORDS)
        return str(words.html(self))
