"""How far to trust a diagnosis, in words."""

from __future__ import annotations

from typing import Any

from ..common.words import digits
from ..diagnosis.decide import Verdict
from ..diagnosis.result import Diagnosis
from .numbers import described_quantity

NOT_SIMULATED = (
    'How often this procedure raises a false alarm could not be simulated: the description has no '
    'equilibrium in some posture, or nothing tells the noise.'
)
NONE_ENDED = (
    'How often this procedure raises a false alarm is not known: no simulation of your postures '
    'ended in the time that it has. Try it on a machine that does nothing else.'
)
OF_THE_CATALOGUE = (
    'All of this is about effects of the catalogue; of a cause outside it it says nothing.'
)


def trust_lines(diagnosis: Diagnosis) -> list[str]:
    """Return what the bootstrap says; nothing where it was not asked for."""
    if 'trust' not in diagnosis.details:
        return []
    trust = diagnosis.details['trust']
    if trust is None:
        return [NOT_SIMULATED]
    if not trust['runs']:
        return [NONE_ENDED]
    low, high = 100.0 * trust['alarm_rate_low'], 100.0 * trust['alarm_rate_high']
    sentences = [
        f'With nothing missing, this procedure raises an alarm in '
        f'{digits(100.0 * trust["alarm_rate"])} % of cases ({trust["runs"]} simulated on your '
        f'postures; 95 %: {digits(low)} to {digits(high)} %).'
    ]
    sizes = [_sizes(name, sizes) for name, sizes in trust['detectable'].items()]
    sentences.append('Smallest sizes that raise it four times in five: ' + '; '.join(sizes) + '.')
    if trust['checked']:
        share = 100.0 * trust['detected'] / trust['checked']
        sentences.append(
            f'Of {trust["checked"]} simulated robots with an effect of such a size, '
            f'{share:.0f} % raised it.'
        )
    if diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE:
        sentences.append(OF_THE_CATALOGUE)
    return sentences


def _sizes(name: str, sizes: dict[str, Any]) -> str:
    shown = [
        f'{key} too small to see'
        if one['size'] is None
        else described_quantity(key, one['unit'], [one['size']], 2)
        for key, one in sizes.items()
    ]
    return f'{name} {", ".join(shown)}'
