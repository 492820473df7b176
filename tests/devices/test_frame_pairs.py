"""FramePairs: which colour belongs to which depth."""

from __future__ import annotations

import numpy as np

from wheelsight.io.devices.camera_driver import FramePairs


def pairs_of(color_s: list[float], depth_s: list[float], gap_s: float = 0.02) -> list[tuple[float, float]]:
    """Handed over in order of time, as two streams come."""
    pairs, found = FramePairs[str](gap_s), []
    for stamp_s, kind in sorted([(s, "color") for s in color_s] + [(s, "depth") for s in depth_s]):
        pair = pairs.add_color(stamp_s, "c") if kind == "color" else pairs.add_depth(stamp_s, "d")
        if pair is not None:
            assert (pair[0].what, pair[1].what) == ("c", "d")
            found.append((pair[0].stamp_s, pair[1].stamp_s))
    return found


def test_each_finds_the_other_of_its_moment() -> None:
    color_s = (np.arange(30) / 30).tolist()
    depth_s = (np.arange(30) / 30 + 0.012).tolist()
    assert pairs_of(color_s, depth_s) == list(zip(color_s, depth_s, strict=True))


def test_what_lacks_a_partner_is_passed_over() -> None:
    assert pairs_of([0.0, 0.1, 0.3], [0.0, 0.2, 0.3]) == [(0.0, 0.0), (0.3, 0.3)]


def test_a_stream_that_stopped_costs_no_memory_and_goes_on() -> None:
    color_s = (np.arange(1000) / 30).tolist()
    assert pairs_of(color_s, [color_s[-1] + 0.001]) == [(color_s[-1], color_s[-1] + 0.001)]
    pairs = FramePairs[str](0.02)
    for stamp_s in color_s:
        pairs.add_color(stamp_s, "c")
    assert pairs.add_depth(color_s[0], "d") is None  # left behind long ago


def test_a_clock_that_was_set_back_pairs_nothing_across() -> None:
    pairs = FramePairs[str](0.02)
    pairs.add_color(100.0, "before")
    pairs.add_color(0.0, "after")
    pair = pairs.add_depth(0.001, "d")
    assert pair is not None
    assert pair[0].what == "after"
