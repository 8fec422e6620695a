"""
Which triples of columns are taken as points of the arm: markers, centres of rims, bodies.

And which columns say whether a marker was seen: State of NDI, visible, occluded and the like.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..common.errors import DataSetError
from ..common.words import listed, listing
from ..data.seen import BoolArray
from .columns import (
    BODY,
    BODY_MARKER,
    DERIVED,
    FILLERS,
    MARKER,
    MISSING,
    ColumnName,
    FloatArray,
    RawTable,
    Triple,
    is_number,
    marker_label,
    names_of,
    triples_of,
)

CHOICES = ('markers', 'rims', 'bodies')
RIM_MIN = 3  # markers that tell a circle
RIGID_SHARE = 0.05  # of a distance: a tracker's noise of 0.3 mm across a rim of 10 mm changes less
ARC_MIN = 0.5  # of the circle's radius over the widest pair: markers within 60° tell no centre
OFF_CIRCLE = 0.1  # of the radius, by which noise may take the markers of a rim off the circle
FRAMES_MAX = 500  # that tell whether markers are fixed to each other: more would say no more
SEEN_SHARE = 0.5  # of the rows: a point without a name that is seen less is a reflection
NAMELESS = ('unlabeled', 'unlabelled', 'unidentified', 'ghost')
# words of the name of a column that says whether a marker was seen, then of what stands in it
SEEN = {'visible', 'visibility', 'seen', 'valid', 'tracked', 'detected'}  # 0: it was not
HIDDEN = {'occluded', 'occlusion', 'hidden', 'missing', 'lost', 'invalid'}  # 0: it was seen
STATE = {'state', 'status'}  # in words
YES, NO = {'1', 'true', 'yes', 'y', 't'}, {'0', 'false', 'no', 'n', 'f'}
LOST = HIDDEN | {'disabled', 'unseen', 'untracked', 'out', 'not', 'bad', 'none', 'unknown'}


@dataclass(frozen=True)
class Points:
    """
    The points that are taken.

    Attributes
    ----------
    columns : tuple of tuple of str
        Of each point x, y, z; of three or more markers on a rim all of theirs.
    told : str
        What they are, and what else could be taken; '' where there is no choice.
    aside : tuple of str
        What is left aside, as what.
    share_aside : float
        Share of the triples that are left aside, but for what an export says they are.
    nameless : tuple of tuple of str
        Markers without a name among these; a named one that was lost may go on in them.

    """

    columns: tuple[tuple[str, ...], ...]
    told: str
    aside: tuple[str, ...]
    share_aside: float
    nameless: tuple[tuple[str, str, str], ...]


def choose_points(tables: Sequence[RawTable], choice: str | None) -> Points:
    """
    Choose the points of the arm among all triples of columns.

    Labelled markers go before bodies, but where bodies are more. Markers that are fixed to each
    other around a circle are the rim of a disk, and give its centre.

    Raises
    ------
    DataSetError
        No triple is a place, or none is of the kind that was asked for.

    """
    found = [(triple, table) for table in tables for triple in triples_of(table)]
    found = list({triple.columns: (triple, table) for triple, table in found}.values())
    places = [(t, table) for t, table in found if not t.quantity and t.kind != DERIVED]
    others = [t for t, _ in found if t.quantity or t.kind == DERIVED]
    if not places:
        raise DataSetError(
            tables[0].name,
            'no columns of a marker are recognised'
            + (f': {listed(_told(others))} are no measured places' if others else ''),
            'name them alike but for the axis, such as tip_x, tip_y, tip_z',
        )
    named = [(t, table) for t, table in places if not _is_nameless(t)]
    loose = [(t, table) for t, table in places if _is_nameless(t)]
    if not named:
        shares = [np.isfinite(_places(*one)).all(axis=1).mean() for one in loose]
        named = [one for one, seen in zip(loose, shares, strict=True) if seen >= SEEN_SHARE]
        named = named or loose
    kept = {t.columns for t, _ in named}
    loose = [one for one in loose if one[0].columns not in kept]
    kinds = (MARKER, BODY_MARKER, BODY)
    groups = {kind: [one for one in named if one[0].kind == kind] for kind in kinds}
    markers = groups[MARKER] or groups[BODY_MARKER]
    rims = _rims(markers)
    around = {t.columns for rim in rims for t in rim}
    single = [(t.columns,) for t, _ in markers if t.columns not in around]
    options: dict[str, list[tuple[tuple[str, ...], ...]]] = {
        'markers': [(t.columns,) for t, _ in markers],
        'rims': [*(tuple(t.columns for t in rim) for rim in rims), *single] if rims else [],
        'bodies': [(t.columns,) for t, _ in groups[BODY]],
    }
    taken = choice or ('rims' if rims else 'markers')
    if choice is None and len(options['bodies']) > len(options[taken]):
        taken = 'bodies'
    if not options[taken]:
        known = [name for name in CHOICES if options[name]]
        raise DataSetError(
            tables[0].name, f'holds no {taken} (--points {taken})', f'use one of {listing(known)}'
        )
    used = {columns for point in options[taken] for columns in point}
    left = [t for t, _ in named if t.columns not in used]
    aside = [*_told(left), *_told(others)]
    unknown = [t for t, table in found if not table.kinds and t in others]
    dropped = len(loose) + len(unknown)
    nameless = tuple(t.columns for t, _ in loose)
    columns = tuple(tuple(c for three in point for c in three) for point in options[taken])
    others_told = [name for name in CHOICES if options[name] and name != taken]
    told = {
        'markers': 'the markers are taken, each by itself',
        'bodies': 'the origins of bodies are taken',
        'rims': 'markers that are fixed to each other around a circle are the rim of a disk and '
        f'give its centre: {listing(marker_label(c) for c in columns if len(c) > 3)}',
    }[taken] + f' (otherwise say --points {" or ".join(others_told)})'
    return Points(
        columns=columns,
        told=told if others_told else '',
        aside=tuple(aside),
        share_aside=dropped / (dropped + len(used)),
        nameless=nameless,
    )


def _told(triples: Iterable[Triple]) -> list[str]:
    """Say what triples are that are left aside: 'tag 1 rvec and 3 more: rotations'."""
    by: dict[str, list[str]] = {}
    for triple in triples:
        what = triple.quantity or triple.kind
        by.setdefault(what, []).append(marker_label(triple.columns))
    return [
        f'{what} ({names[0]}{f" and {len(names) - 1} more" if len(names) > 1 else ""})'
        for what, names in by.items()
    ]


def _is_nameless(triple: Triple) -> bool:
    return triple.columns[0].startswith('*') or bool(set(triple.name) & set(NAMELESS))


def _places(triple: Triple, table: RawTable) -> FloatArray:
    step = max(len(table) // FRAMES_MAX, 1)
    places = np.column_stack([table.numbers(column)[::step] for column in triple.columns])
    places[(places == 0.0).all(axis=1)] = np.nan
    return places


def _rims(markers: Sequence[tuple[Triple, RawTable]]) -> list[list[Triple]]:
    """Return the markers of each body or beginning of a name that are fixed around a circle."""
    groups: dict[str, list[tuple[Triple, RawTable]]] = {}
    for triple, table in markers:
        body, mark, _ = triple.columns[0].rpartition(':')
        groups.setdefault(body if mark else ' '.join(triple.name[:-1]), []).append((triple, table))
    return [
        [triple for triple, _ in group]
        for group in groups.values()
        if len(group) >= RIM_MIN and _is_rim(np.stack([_places(*one) for one in group], axis=1))
    ]


def _is_rim(places: FloatArray) -> bool:
    """Tell whether markers (T, K, 3) keep their distances, and lie around a circle."""
    seen = places[np.isfinite(places).all(axis=(1, 2))]
    if not len(seen):
        return False
    i, j = np.triu_indices(seen.shape[1], 1)
    apart = np.linalg.norm(seen[:, i] - seen[:, j], axis=2)
    usual = np.median(apart, axis=0)
    spread = np.percentile(apart, 90, axis=0) - np.percentile(apart, 10, axis=0)
    if not (spread <= RIGID_SHARE * usual.max()).all():
        return False
    one = seen[np.argmin(np.abs(apart - usual).max(axis=1))][None]
    centre = circle_centres(one)
    radii = np.linalg.norm(one[0] - centre, axis=1)
    return bool(
        np.ptp(radii) <= OFF_CIRCLE * radii.mean()
        and ARC_MIN * usual.max() <= radii.mean() <= usual.max()
    )


def circle_centres(points: FloatArray) -> FloatArray:
    """
    Return the centres (T, 3) of the circles through points (T, K, 3); of one point itself.

    The circle lies in the plane that fits best and has the least sum of squares of
    |p - c|² - r² (Kåsa 1976), exact for three points. NaN where a point is missing.
    """
    if points.shape[1] == 1:
        return points[:, 0]
    centres = np.full((len(points), 3), np.nan)
    seen = np.isfinite(points).all(axis=(1, 2))
    middle = points[seen].mean(axis=1, keepdims=True)
    _, _, axes = np.linalg.svd(points[seen] - middle, full_matrices=False)
    plane = axes[:, :2]  # (T, 2, 3)
    flat = (points[seen] - middle) @ plane.transpose(0, 2, 1)  # (T, K, 2)
    system = np.concatenate([2.0 * flat, np.ones((*flat.shape[:2], 1))], axis=2)
    found = np.linalg.pinv(system) @ (flat**2).sum(axis=2)[..., None]
    centres[seen] = middle[:, 0] + (found[:, :2].transpose(0, 2, 1) @ plane)[:, 0]
    return centres


def kind_of_flag(name: ColumnName) -> set[str] | None:
    """Return the words of which a column's name has one: `SEEN`, `HIDDEN` or `STATE`."""
    return next((kind for kind in (SEEN, HIDDEN, STATE) if kind & set(name.words)), None)


def flag_columns(
    table: RawTable, markers: Sequence[Sequence[str]]
) -> Iterator[tuple[ColumnName, set[str], list[int]]]:
    """
    Find columns that say whether markers were seen.

    Parameters
    ----------
    table : RawTable
    markers : sequence of columns
        Of x, y and z of each marker.

    Yields
    ------
    name : ColumnName
    kind : set of str
        `SEEN`, `HIDDEN` or `STATE`.
    of : list of int
        The markers that it is about: the one with the same words, all where it names none.

    """
    names = names_of(table)
    used = {column for columns in markers for column in columns}
    own = {name.column: name for name in names if name.column in used}
    owners = [_words(own[c[0]].component[2]) if c[0] in own else () for c in markers]
    for name in names:
        kind = kind_of_flag(name)
        if kind is None or name.column in used:
            continue
        if kind is STATE and name.column in table.columns:
            continue  # numbers: what they mean only their maker knows
        owner = _words(word for word in name.words if word not in kind)
        of = [j for j, words in enumerate(owners) if words == owner]
        if of or not owner:
            yield name, kind, of or list(range(len(markers)))


def not_visible(table: RawTable, markers: Sequence[Sequence[str]]) -> dict[str, BoolArray]:
    """Return, by why, the readings (R, J) that a column says were not seen."""
    found = {}
    for name, kind, of in flag_columns(table, markers):
        if name.column in table.columns:
            values = table.columns[name.column]
            hidden = values == 0.0 if kind is SEEN else np.nan_to_num(values) != 0.0
        else:
            hidden = np.array([_says_hidden(text, kind) for text in table.texts[name.column]])
        if hidden.any() and not hidden.all():
            mask = np.zeros((len(table), len(markers)), dtype=bool)
            mask[:, of] = hidden[:, None]
            found[f'the column {name.column} says so'] = mask
    return found


def _words(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(word for word in words if word not in FILLERS)


def _says_hidden(text: str, kind: set[str]) -> bool:
    words = set(text.lower().replace('_', ' ').split())
    if text in MISSING:
        return False
    if is_number(text):
        return kind is not STATE and (float(text) == 0.0) == (kind is SEEN)
    if words & LOST:
        return True
    return bool(words & NO) if kind is SEEN else kind is HIDDEN and bool(words & YES)
