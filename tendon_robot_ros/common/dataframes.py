"""Tables of pandas and Parquet, for those who have them: everything else works without."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

from .errors import MissingExtraError


def pandas() -> Any:
    """Return the package pandas; MissingExtraError where it is not installed."""
    return _of_the_tables('pandas')


def arrow() -> Any:
    """Return pyarrow with its Parquet; MissingExtraError where it is not installed."""
    _of_the_tables('pyarrow.parquet')
    return _of_the_tables('pyarrow')


def _of_the_tables(name: str) -> Any:
    """Import a package of the extra `tables`."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingExtraError(name.split('.')[0], 'tables') from None


def make_frame(
    columns: Mapping[str, Any],
    units: Mapping[str, str],
    ordered: Mapping[str, Sequence[str]] | None = None,
) -> Any:
    """
    Return a DataFrame; `frame.attrs['units']` says the units of its columns.

    Columns of names that are `ordered` sort as given: posture 2 before posture 10, and markers
    from the base to the tip.
    """
    package = pandas()
    names = {
        key: package.Categorical(columns[key], dict.fromkeys(known), ordered=True)
        for key, known in (ordered or {}).items()
    }
    frame = package.DataFrame({**columns, **names})
    frame.attrs['units'] = {name: units[name] for name in columns if name in units}
    return frame
