"""How far to trust a diagnosis, in words."""

from __future__ import annotations

from typing import Any

from ..analysis.result import Diagnosis
from .quantities import described_quantity
from .words import digits


def lines(found: Diagnosis) -> list[str]:
    """Return what the bootstrap says; nothing where it was not asked for."""
    trust = found.details.get('trust')
    if not trust or not trust['runs']:
        return []
    low, high = 100.0 * trust['alarm_rate_low'], 100.0 * trust['alarm_rate_high']
    said = [
        f'With nothing missing, this procedure raises an alarm in '
        f'{digits(100.0 * trust["alarm_rate"])} % of cases ({trust["runs"]} simulated on your '
        f'postures; 95 %: {digits(low)} to {digits(high)} %).'
    ]
    sizes = [_sizes(name, sizes) for name, sizes in trust['detectable'].items()]
    said.append('Smallest sizes that raise it four times in five: ' + '; '.join(sizes) + '.')
    if trust['checked']:
        share = 100.0 * trust['detected'] / trust['checked']
        said.append(
            f'Of {trust["checked"]} simulated robots with an effect of such a size, '
            f'{share:.0f} % raised it.'
        )
    return said


def _sizes(name: str, sizes: dict[str, Any]) -> str:
    shown = [
        f'{key} too small to see'
        if one['size'] is None
        else described_quantity(key, one['unit'], [one['size']], 2)
        for key, one in sizes.items()
    ]
    return f'{name} {", ".join(shown)}'
