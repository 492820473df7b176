"""A batch held against an earlier one: which figures are worse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from wheelsight.batch.settings import BatchSettings
from wheelsight.batch.table import FIGURES, Figure, Row, Spread, shown


@dataclass(frozen=True, slots=True)
class Comparison:
    """With a baseline.

    Attributes:
        worse: a line for each figure that is.
        unmatched: a line for each row that only one of the two has.
        compared: how many rows both have.
    """

    worse: tuple[str, ...]
    unmatched: tuple[str, ...]
    compared: int


def compare(
    rows: Sequence[Row],
    baseline: Sequence[Row],
    tolerance: float,
    cost_tolerance: float | None = None,
    settings: BatchSettings | None = None,
) -> Comparison:
    """Hold medians and worst against those of the baseline's row of the same recording and configuration.

    Args:
        rows: of now.
        baseline: of before.
        tolerance: share by which errors may grow, and the share of frames with a pose fall.
        cost_tolerance: likewise of time and memory; of None they are not judged, since another computer has others.
        settings: changes that are too small to count.
    """
    settings = settings or BatchSettings()
    now, before = ({(row.recording, row.config): row for row in one} for one in (rows, baseline))
    worse = [
        f"{row.recording}, {row.config}: {what}"
        for key, row in now.items()
        if key in before
        for what in _worse(row, before[key], tolerance, cost_tolerance, settings)
    ]
    lonely = [f"{', '.join(key)}: not in the baseline" for key in now if key not in before]
    lonely += [f"{', '.join(key)}: in the baseline alone" for key in before if key not in now]
    return Comparison(tuple(worse), tuple(lonely), len(now.keys() & before.keys()))


def _worse(
    row: Row, before: Row, tolerance: float, cost_tolerance: float | None, settings: BatchSettings
) -> Iterator[str]:
    if not row.seeds:
        if before.seeds:
            yield "broken"
        return
    for figure in FIGURES:
        allowed = cost_tolerance if figure.is_cost else tolerance
        was, found = before.figures.get(figure.name), row.figures.get(figure.name)
        if allowed is None or was is None:
            continue
        if found is None:
            yield f"no {figure.title} any more"
            continue
        for name in Spread._fields:
            old, new = getattr(was, name), getattr(found, name)
            if _is_worse(figure, old, new, allowed, settings):
                yield f"{figure.title} {name} {shown(figure, new)}, was {shown(figure, old)}"
                break


def _is_worse(figure: Figure, old: float, new: float, allowed: float, settings: BatchSettings) -> bool:
    grown = old - new if figure.grows_better else new - old
    least = 0.0 if figure.is_cost else settings.least_share if figure.grows_better else settings.least_error
    return grown > max(least, allowed * abs(old))
