"""FrameGate: which frames are worth a look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.events import RgbdFrame
from wheelsight.geometry import se3
from wheelsight.localizer._frame_gate import FrameGate

AHEAD = se3.exp([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
TURNED = se3.exp([0.0, 0.0, 0.0, 0.0, 0.02, 0.0])


def frame(stamp_s: float, seed: int = 0) -> RgbdFrame:
    """Noise, as a camera's."""
    rng = np.random.default_rng(seed)
    color = rng.integers(0, 256, (24, 32, 3), np.uint8)
    return RgbdFrame(stamp_s, color, rng.uniform(1, 3, (24, 32)).astype(np.float32))


def test_frames_in_order_pass() -> None:
    gate = FrameGate()
    assert [gate.why_not(frame(k / 30, k), AHEAD) for k in range(5)] == [""] * 5


@pytest.mark.parametrize("stamp_s", [1.0, 0.9, -1e9, np.nan, np.inf, -np.inf])
def test_what_does_not_come_after_the_newest_does_not_pass_nor_count(stamp_s: float) -> None:
    gate = FrameGate()
    gate.why_not(frame(1.0), None)
    assert gate.why_not(frame(stamp_s, 1), None) == "its stamp does not come after 1.000000 s"
    assert gate.why_not(frame(1.1, 2), None) == ""


def test_one_stamp_from_the_future_is_no_clock_but_some_in_a_row_are() -> None:
    gate = FrameGate()
    gate.why_not(frame(1.0), None)
    assert "s ahead" in gate.why_not(frame(1e6, 1), None)
    assert gate.why_not(frame(1.1, 2), None) == ""
    paused = [gate.why_not(frame(1e6 + k, 3 + k), None) for k in range(7)]
    assert [why == "" for why in paused] == [False] * 4 + [True] * 3


@pytest.mark.parametrize("moved", [AHEAD, TURNED], ids=["way", "turn"])
def test_a_camera_that_hangs_while_the_wheels_move_does_not_pass(moved: np.ndarray) -> None:
    gate = FrameGate()
    gate.why_not(frame(1.0), None)
    assert "frame before" in gate.why_not(frame(1.1), moved)
    assert "frame before" in gate.why_not(frame(1.2), moved)
    assert gate.why_not(frame(1.3, 1), moved) == ""


def test_a_robot_that_stands_may_see_the_same_twice() -> None:
    gate = FrameGate()
    gate.why_not(frame(1.0), None)
    assert gate.why_not(frame(1.1), np.eye(4)) == ""
    assert gate.why_not(frame(1.2), None) == ""


@pytest.mark.parametrize("part", ["color", "depth_m"])
def test_images_of_which_one_is_new_are_new(part: str) -> None:
    gate, first, other = FrameGate(), frame(1.0), frame(1.1, 1)
    gate.why_not(first, None)
    assert gate.why_not(replace(first, stamp_s=1.1, **{part: getattr(other, part)}), AHEAD) == ""


def test_wheels_are_waited_for_a_second_and_no_longer() -> None:
    gate = FrameGate()
    assert [gate.waits_for_wheels(frame(s)) for s in (5.0, 5.5, 5.99, 6.0, 7.0)] == [True, True, True, False, False]
    gate = FrameGate()
    assert gate.waits_for_wheels(frame(5.0))
    gate.wheels_are_heard = True
    assert not gate.waits_for_wheels(frame(5.1))
