"""What an occupancy map keeps of keyframes rests on the disk, and comes back as it was."""

from __future__ import annotations

import os
import tempfile

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from wheelsight.core.errors import MapError
from wheelsight.core.keyframes import KeyframeId
from wheelsight.mapping.occupancy import SeenDepth, SeenDepths


def seen(number: int) -> SeenDepth:
    rng = np.random.default_rng(number)
    height, width = 6 + number, 8
    slopes = (rng.random(size).astype(np.float32) for size in (width, height))
    return SeenDepth(rng.integers(0, 65_536, (height, width)).astype(np.uint16), *slopes)


def kept(in_memory: int) -> SeenDepths:
    depths = SeenDepths(in_memory)
    for number in (5, 0, 3, 4):
        depths[KeyframeId(number)] = seen(number)
    return depths


@pytest.mark.parametrize("in_memory", [0, 2, 9])
def test_what_rests_comes_back_as_it_was_and_in_order(in_memory: int) -> None:
    depths = kept(in_memory)
    assert (list(depths), len(depths), 3 in depths, 1 in depths) == ([5, 0, 3, 4], 4, True, False)
    for number in depths:
        back, given = depths[number], seen(number)
        assert_array_equal(back.depth, given.depth)
        assert_array_equal(back.slope_x, given.slope_x)
        assert_array_equal(back.slope_y, given.slope_y)


def test_without_a_disk_all_stay_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    depths = kept(1)
    assert_array_equal(depths[KeyframeId(4)].depth, seen(4).depth)


def test_what_the_disk_has_lost_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    depths = kept(0)
    read = os.pread
    monkeypatch.setattr(os, "pread", lambda file, count, begin: read(file, count, begin)[:-1])
    with pytest.raises(MapError, match="is cut off"):
        depths[KeyframeId(0)]
