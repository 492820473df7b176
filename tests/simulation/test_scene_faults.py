"""Faults of a place do what they say, when they say, and nothing else."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight_sim.faults import CameraFault, DarkRoom, DirectSun, GlassWall, Mirror, Silence, StillView, WheelsStand

FRAMES, RATE_HZ, WIDTH = 90, 30.0, 64
OF_IMAGES = (DarkRoom, DirectSun, GlassWall, Mirror, StillView)


@pytest.fixture(scope="module")
def events() -> list[Event]:
    """Three seconds of frames that all differ, wheels at 50 Hz and a gyroscope."""
    rng = np.random.default_rng(3)
    frames: list[Event] = [
        RgbdFrame(
            round(i / RATE_HZ, 6),
            rng.integers(30, 200, (48, WIDTH, 3), np.uint8),
            rng.uniform(0.5, 4, (48, WIDTH)).astype(np.float32),
            i,
        )
        for i in range(FRAMES)
    ]
    wheels = [WheelTicks(round(i * 0.02 + 0.001, 6), 3 * i, 5 * i) for i in range(150)]
    gyro = [YawRate(round(i * 0.1 + 0.002, 6), 0.1) for i in range(30)]
    return sorted([*frames, *wheels, *gyro], key=lambda event: event.stamp_s)


def frames_of(events: Iterable[Event]) -> list[RgbdFrame]:
    return [event for event in events if isinstance(event, RgbdFrame)]


def spoilt(fault: CameraFault, events: list[Event]) -> list[tuple[RgbdFrame, RgbdFrame]]:
    """Frames of the second second as they come, and as they were."""
    pairs = zip(frames_of(fault.apply(events)), frames_of(events), strict=True)
    return [(after, before) for after, before in pairs if 1.0 <= before.stamp_s < 2.0]


@pytest.mark.parametrize("kind", OF_IMAGES)
def test_only_images_of_that_time_change_and_each_time_alike(kind: type, events: list[Event]) -> None:
    fault = kind(begin_s=1.0, end_s=2.0)
    for after, before in zip(fault.apply(iter(events)), events, strict=True):
        if not isinstance(before, RgbdFrame) or not 1.0 <= before.stamp_s < 2.0:
            assert after is before
            continue
        assert isinstance(after, RgbdFrame)
        assert (after.stamp_s, after.index) == (before.stamp_s, before.index)
        assert after.color.dtype == np.dtype(np.uint8)
        assert after.depth_m.dtype == np.dtype(np.float32)
        assert (after.depth_m >= 0).all()
        assert not np.array_equal(after.color, before.color)
    twice = [frames_of(fault.apply(events)) for _ in range(2)]
    for one, other in zip(*twice, strict=True):
        np.testing.assert_array_equal(one.color, other.color)
        np.testing.assert_array_equal(one.depth_m, other.depth_m)


def test_glass_takes_depth_and_reflects_in_its_part(events: list[Event]) -> None:
    for after, before in spoilt(GlassWall(begin_s=1.0, end_s=2.0, share=0.5), events):
        np.testing.assert_array_equal(after.depth_m[:, : WIDTH // 2], before.depth_m[:, : WIDTH // 2])
        np.testing.assert_array_equal(after.color[:, : WIDTH // 2], before.color[:, : WIDTH // 2])
        pane = after.depth_m[:, WIDTH // 2 :]
        assert 0.1 < np.mean(pane > 0) < 0.2
        np.testing.assert_array_equal(pane[pane > 0], before.depth_m[:, WIDTH // 2 :][pane > 0])
        mixed = 0.75 * before.color[:, -1].astype(float) + 0.25 * before.color[:, 0]
        np.testing.assert_allclose(after.color[:, -1], mixed, atol=0.51)


def test_a_mirror_shows_the_other_side_turned(events: list[Event]) -> None:
    for after, before in spoilt(Mirror(begin_s=1.0, end_s=2.0, share=0.25), events):
        quarter = WIDTH // 4
        np.testing.assert_array_equal(after.color[:, -1], before.color[:, 0])
        np.testing.assert_array_equal(after.depth_m[:, -quarter:], before.depth_m[:, :quarter][:, ::-1])
        np.testing.assert_array_equal(after.color[:, :-quarter], before.color[:, :-quarter])


def test_the_sun_blinds_a_patch_that_wanders_and_darkens_the_rest(events: list[Event]) -> None:
    middles = []
    for after, before in spoilt(DirectSun(begin_s=1.0, end_s=2.0, period_s=1.2, darkens=3.0), events):
        is_blind = after.depth_m == 0
        assert (after.color[is_blind] == 255).all()
        expected = before.color[~is_blind] * 3.0 ** (-1 / 2.2)
        np.testing.assert_allclose(after.color[~is_blind], expected, atol=0.51)
        np.testing.assert_array_equal(after.depth_m[~is_blind], before.depth_m[~is_blind])
        middles.append(np.nonzero(is_blind)[1].mean())
    assert middles[-1] > middles[0] + WIDTH / 4


def test_a_dark_room_leaves_a_few_levels_and_depth(events: list[Event]) -> None:
    for after, before in spoilt(DarkRoom(begin_s=1.0, end_s=2.0), events):
        assert after.color.mean() < 0.1 * before.color.mean() + 2
        assert after.color.std() > 2
        np.testing.assert_array_equal(after.depth_m, before.depth_m)


def test_a_view_that_stands_is_measured_again_each_time(events: list[Event]) -> None:
    pairs = spoilt(StillView(begin_s=1.0, end_s=2.0), events)
    first = pairs[0][1]
    for after, _ in pairs:
        assert 0 < np.abs(after.color.astype(int) - first.color).mean() < 3
        assert 0 < np.abs(after.depth_m - first.depth_m).max() < 0.15
    assert len({after.color.tobytes() for after, _ in pairs}) == len(pairs)


def test_wheels_of_a_robot_that_is_carried_go_on_from_where_they_stood(events: list[Event]) -> None:
    reported = [event for event in WheelsStand(begin_s=1.0, end_s=2.0).apply(events) if isinstance(event, WheelTicks)]
    counts = {event.stamp_s: (event.left, event.right) for event in reported}
    assert counts[0.981] == counts[1.001] == counts[1.981] == (147, 245)
    assert counts[2.001] == (150, 250)
    assert counts[2.981] == (297, 495)
    others = [event for event in events if not isinstance(event, WheelTicks)]
    spoilt_events = WheelsStand(begin_s=1.0, end_s=2.0).apply(events)
    assert [event for event in spoilt_events if not isinstance(event, WheelTicks)] == others


def test_in_silence_nothing_comes(events: list[Event]) -> None:
    reported = list(Silence(begin_s=1.0, end_s=2.0).apply(events))
    assert reported == [event for event in events if not 1.0 <= event.stamp_s < 2.0]
    assert len(reported) < len(events)


@pytest.mark.parametrize("share", [-0.1, 1.1, np.nan])
def test_a_part_of_the_view_is_a_share(share: float) -> None:
    for kind in (GlassWall, Mirror):
        with pytest.raises(ConfigError, match="share is"):
            kind(share=share)
