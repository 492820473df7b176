"""Where equal labels follow each other."""

from __future__ import annotations


def runs(labels: list[str]) -> list[tuple[int, int, str]]:
    """Unbroken runs of equal labels, as (first, one past the last, label)."""
    starts = [i for i, label in enumerate(labels) if i == 0 or label != labels[i - 1]]
    return [(i, j, labels[i]) for i, j in zip(starts, [*starts, len(labels)][1:], strict=True)]
