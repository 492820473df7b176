"""Grids of cases of one kind: a few of them are run always, the others with the slow tests."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def mostly_slow(cases: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Cases for `parametrize`, of which all but the quick ones are slow; a case of several arguments is a tuple."""
    every = list(cases)
    assert all(case in every for case in quick), "a quick case is none of the grid"
    return [case if case in quick else pytest.param(*_arguments(case), marks=pytest.mark.slow) for case in every]


def _arguments(case: Any) -> tuple[Any, ...]:
    return case if isinstance(case, tuple) else (case,)
