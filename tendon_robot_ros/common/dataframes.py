"""Tables of pandas, for those who have it: everything here works without."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .errors import MissingExtraError


def pandas() -> Any:
    """
    Return the package pandas.

    Raises
    ------
    MissingExtraError
        It is not installed.

    """
    try:
        import pandas as package
    except ImportError:
        raise MissingExtraError('pandas', 'tables') from None
    return package


def make_frame(columns: Mapping[str, Any], units: Mapping[str, str]) -> Any:
    """Return a DataFrame; `frame.attrs['units']` says the units of its columns."""
    frame = pandas().DataFrame(dict(columns))
    frame.attrs['units'] = {name: units[name] for name in columns if name in units}
    return frame
