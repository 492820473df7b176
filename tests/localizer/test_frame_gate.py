"""FrameGate: which frames are worth a look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.checks import FrameGate, FrameRefusal
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame

AHEAD = se3.exp([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
TURNED = se3.exp([0.0, 0.0, 0.0, 0.0, 0.02, 0.0])


def frame(stamp_s: float, seed: int = 0) -> RgbdFrame:
    """Noise, as a camera's."""
    rng = np.random.default_rng(seed)
    color = rng.integers(0, 256, (24, 32, 3), np.uint8)
    return RgbdFrame(stamp_s, color, rng.uniform(1, 3, (24, 32)).astype(np.float32))


def whys(gate: FrameGate, frames: list[RgbdFrame], T_last_frame: np.ndarray | None = None) -> list[str]:
    """What is noted of each, nothing of one that passes."""
    refusals = [gate.why_not(frame, T_last_frame) for frame in frames]
    return ["" if refusal is None else refusal.note for refusal in refusals]


def test_frames_in_order_pass() -> None:
    assert whys(FrameGate(), [frame(k / 30, k) for k in range(5)], AHEAD) == [""] * 5


@pytest.mark.parametrize("T_last_frame", [None, AHEAD], ids=["alone", "on the way"])
def test_an_image_listed_twice_is_a_repeat_and_the_next_one_none(T_last_frame: np.ndarray | None) -> None:
    gate = FrameGate()
    refusals = [gate.why_not(frame(k / 30, k // 2), T_last_frame) for k in range(6)]
    assert [refusal is not None for refusal in refusals] == [False, True] * 3
    assert all(r == FrameRefusal("the same image as before", is_repeat=True) for r in refusals if r)


@pytest.mark.parametrize("T_last_frame", [None, AHEAD, TURNED], ids=["alone", "way", "turn"])
def test_what_repeats_for_over_a_second_hangs_and_may_come_back(T_last_frame: np.ndarray | None) -> None:
    gate = FrameGate()
    refusals = [gate.why_not(frame(k / 10), T_last_frame) for k in range(1, 15)]
    assert [r.is_repeat for r in refusals if r] == [True] * 10 + [False] * 3
    assert refusals[-1] is not None
    assert refusals[-1].note == "the camera hangs: the same image for over 1 s"
    since = "the camera was left out from 0.0 s after the first frame"
    assert gate.warnings == (f"{since} on: it repeats one image; check its cable and driver",)
    assert gate.why_not(frame(1.5, 1), T_last_frame) is None
    assert gate.warnings == (f"{since} until 1.4 s: it repeats one image; check its cable and driver",)
    whys(gate, [frame(k / 10, 2) for k in range(20, 40)], T_last_frame)
    assert gate.warnings[0].startswith("the camera was left out 2 times, last from 1.9 s after")


def test_a_robot_that_stands_by_its_wheels_may_see_the_same_for_long() -> None:
    gate = FrameGate()
    gate.why_not(frame(0.0), np.eye(4))
    assert whys(gate, [frame(k / 10) for k in range(1, 50)], np.eye(4)) == [""] * 49


@pytest.mark.parametrize("part", ["color", "depth_m"])
def test_images_of_which_one_is_new_are_new(part: str) -> None:
    first, other = frame(1.0), frame(1.1, 1)
    mixed = replace(first, stamp_s=1.1, **{part: getattr(other, part)})
    assert whys(FrameGate(), [first, mixed], AHEAD) == ["", ""]


def test_images_that_show_nothing_do_not_repeat() -> None:
    covered = [RgbdFrame(k / 30, np.zeros((24, 32, 3), np.uint8), np.zeros((24, 32), np.float32)) for k in range(3)]
    bare = [replace(covered[0], stamp_s=1.0 + k, depth_m=np.full((24, 32), 2.0, np.float32)) for k in range(3)]
    assert whys(FrameGate(), [*covered, *bare]) == [""] * 6


def test_a_driver_may_write_each_frame_where_it_wrote_the_last_one() -> None:
    gate, buffer = FrameGate(), frame(1.0)
    assert gate.why_not(buffer) is None
    buffer.color[:], buffer.depth_m[:] = frame(1.1, 1).color, frame(1.1, 1).depth_m
    assert gate.why_not(replace(buffer, stamp_s=1.1)) is None


def test_wheels_are_waited_for_a_second_and_no_longer() -> None:
    gate = FrameGate()
    assert [gate.waits_for_wheels(frame(s)) for s in (5.0, 5.5, 5.99, 6.0, 7.0)] == [True, True, True, False, False]
    gate = FrameGate()
    assert gate.waits_for_wheels(frame(5.0))
    gate.has_wheels = True
    assert not gate.waits_for_wheels(frame(5.1))
