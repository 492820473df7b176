"""Memory that was freed goes back to the system."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from benchmarks.joined_hour import memory_mb
from wheelsight.app.run.track import give_back

PIECE, COUNT = 50_000, 2_000  # 100 MB in pieces that come from the heap


def test_what_lies_free_between_pieces_in_use_goes_back() -> None:
    if not hasattr(ctypes.CDLL(None), "malloc_trim") or np.isnan(memory_mb()):
        pytest.skip("no glibc, or no Linux")
    pieces = [np.ones(PIECE, np.uint8) for _ in range(COUNT)]
    held_mb = memory_mb()
    kept = pieces[-1]
    del pieces
    give_back()
    assert memory_mb() < held_mb - 80
    assert kept.sum() == PIECE


def test_without_glibc_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    class Other:
        """A C library of another kind."""

    monkeypatch.setattr(ctypes, "CDLL", lambda name: Other())
    give_back()
