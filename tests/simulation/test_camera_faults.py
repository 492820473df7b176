"""Camera faults do what they say, when they say, and nothing else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks, YawRate
from wheelsight_sim.faults import (
    CableOut,
    Covered,
    DepthHoles,
    ExposureSteps,
    FramesDropped,
    LateClock,
    LightsOff,
    LowRate,
    StuckImage,
    events_with,
)

FRAMES, RATE_HZ = 90, 30.0
ALL = (CableOut, Covered, DepthHoles, ExposureSteps, FramesDropped, LateClock, LightsOff, LowRate, StuckImage)
IMAGE_FAULTS = (Covered, DepthHoles, ExposureSteps, LightsOff, StuckImage)


@pytest.fixture(scope="module")
def events():
    """Three seconds of frames that all differ, wheels at 50 Hz, a gyroscope, and one frame that could not be read."""
    rng = np.random.default_rng(3)
    frames: list[RgbdFrame | SkippedFrame] = [
        RgbdFrame(
            round(i / RATE_HZ, 6),
            rng.integers(0, 256, (48, 64, 3), np.uint8),
            rng.uniform(0.5, 4, (48, 64)).astype(np.float32),
            i,
        )
        for i in range(FRAMES)
    ]
    frames[50] = SkippedFrame(frames[50].stamp_s, "unreadable", 50)
    wheels = [WheelTicks(round(i * 0.02 + 0.001, 6), i, 2 * i) for i in range(150)]
    gyro = [YawRate(round(i * 0.1 + 0.002, 6), 0.1) for i in range(30)]
    return sorted([*frames, *wheels, *gyro], key=lambda event: event.stamp_s)


def frames_of(events):
    return [event for event in events if isinstance(event, RgbdFrame)]


def others_of(events):
    return [event for event in events if not isinstance(event, RgbdFrame | SkippedFrame)]


@pytest.mark.parametrize("fault", ALL)
def test_wheels_and_order_of_time_are_untouched(fault, events):
    for given_events in (events, iter(events)):
        spoilt = list(fault(begin_s=1.0, end_s=2.0).apply(given_events))
        assert others_of(spoilt) == others_of(events)
        stamps_s = [event.stamp_s for event in spoilt]
        assert stamps_s == sorted(stamps_s)


@pytest.mark.parametrize("fault", ALL)
def test_frames_outside_its_time_are_the_very_same(fault, events):
    spoilt = fault(begin_s=1.0, end_s=2.0).apply(events)
    before_and_after = [e for e in frames_of(events) if not 1.0 <= e.stamp_s < 2.0]
    kept = {id(e) for e in spoilt}
    if fault is StuckImage:  # stamps them again, images by reference
        stuck = {e.index: e for e in StuckImage(begin_s=1.0, end_s=2.0).apply(events) if isinstance(e, RgbdFrame)}
        assert all(stuck[e.index].color is e.color for e in before_and_after)
    else:
        assert all(id(e) in kept for e in before_and_after)


@pytest.mark.parametrize("fault", ALL)
def test_the_same_fault_twice_is_the_same_and_begins_anywhere(fault, events):
    def reported(stream):
        return [(e.stamp_s, e.index, e.color.tobytes(), e.depth_m.tobytes()) for e in frames_of(fault().apply(stream))]

    once = reported(events)
    assert reported(events) == once
    if fault is not StuckImage:
        late = [event for event in events if event.stamp_s >= 1.0]
        assert reported(late) == [one for one in once if one[0] >= 1.0 + (0.03 if fault is LateClock else 0.0)]


@pytest.mark.parametrize("fault", ALL)
def test_a_time_that_ends_before_it_begins_is_refused(fault):
    for end_s in (1.0, 0.5, math.nan):
        with pytest.raises(ConfigError, match="never acts"):
            fault(begin_s=1.0, end_s=end_s)


@pytest.mark.parametrize("fault", IMAGE_FAULTS)
def test_images_keep_shape_and_type_and_the_given_ones_stay_as_they_are(fault, events):
    copies = [(e.color.copy(), e.depth_m.copy()) for e in frames_of(events)]
    for spoilt, original, (color, depth_m) in zip(
        frames_of(fault().apply(events)), frames_of(events), copies, strict=True
    ):
        assert (spoilt.color.shape, spoilt.color.dtype) == (color.shape, np.uint8)
        assert (spoilt.depth_m.shape, spoilt.depth_m.dtype) == (depth_m.shape, np.float32)
        np.testing.assert_array_equal(original.color, color)
        np.testing.assert_array_equal(original.depth_m, depth_m)


def test_without_light_colour_is_black_and_depth_goes_on(events):
    for spoilt, original in zip(frames_of(LightsOff().apply(events)), frames_of(events), strict=True):
        assert spoilt.color.max() < 15
        assert spoilt.color.std() > 0.5  # a sensor's noise, no two frames alike
        assert spoilt.depth_m is original.depth_m
    first, second = frames_of(LightsOff().apply(events))[:2]
    assert (first.color != second.color).any()


@pytest.mark.parametrize("cover_m", [0.0, 0.04])
def test_a_cover_hides_all(events, cover_m):
    for spoilt in frames_of(Covered(cover_m=cover_m).apply(events)):
        assert spoilt.color.max() < 15
        assert (spoilt.depth_m == np.float32(cover_m)).all()


def test_holes_take_the_share_they_say_and_nothing_else(events):
    fault = DepthHoles(blobs=0.3, speckle=0.2, holds_frames=10)
    missing = []
    for spoilt, original in zip(frames_of(fault.apply(events)), frames_of(events), strict=True):
        gone = spoilt.depth_m == 0
        assert (spoilt.depth_m[~gone] == original.depth_m[~gone]).all()
        assert spoilt.color is original.color
        missing.append(gone)
    assert np.mean(missing) == pytest.approx(0.3 + 0.7 * 0.2, abs=0.01)
    # What is missing in all ten frames of a blob's life is the blob, but for 0.2¹⁰ of speckle.
    first, next_ = (np.logical_and.reduce(missing[start : start + 10]) for start in (0, 10))
    assert first.mean() == pytest.approx(0.3, abs=0.005)
    assert (first != next_).mean() > 0.1


def test_exposure_multiplies_light_and_clips(events):
    fault = ExposureSteps(period_s=0.5, stops=2.0, seed=4)
    gains = set()
    for spoilt, original in zip(frames_of(fault.apply(events)), frames_of(events), strict=True):
        gain = fault.gain_at(original.stamp_s)
        gains.add(gain)
        light = (original.color / 255.0) ** 2.2 * gain
        np.testing.assert_allclose(spoilt.color, 255 * np.minimum(light, 1) ** (1 / 2.2), atol=0.51)
        assert spoilt.depth_m is original.depth_m
    assert len(gains) == 6
    assert all(0.25 <= gain <= 4 for gain in gains)
    assert ExposureSteps(begin_s=1.0).gain_at(0.9) == 1.0


def test_a_cable_that_is_out_brings_nothing(events):
    left = [e for e in CableOut(begin_s=1.0, end_s=2.0).apply(events) if isinstance(e, RgbdFrame | SkippedFrame)]
    assert len(left) == FRAMES - 30
    assert not [e for e in left if 1.0 <= e.stamp_s < 2.0]


def test_a_share_of_frames_is_lost_by_chance(events):
    kept = {e.index for e in frames_of(FramesDropped(share=0.2).apply(events))}
    assert 0.65 * FRAMES < len(kept) < 0.92 * FRAMES
    assert kept != {e.index for e in frames_of(FramesDropped(share=0.2, seed=1).apply(events))}
    assert not frames_of(FramesDropped(share=1.0).apply(events))
    assert len(frames_of(FramesDropped(share=0.0).apply(events))) == FRAMES - 1


@pytest.mark.parametrize("rate_hz", [3.0, 5.0, 7.0, 15.0, 30.0, 60.0])
def test_a_low_rate_is_that_rate(events, rate_hz):
    stamps_s = [e.stamp_s for e in LowRate(rate_hz=rate_hz).apply(events) if isinstance(e, RgbdFrame | SkippedFrame)]
    assert len(stamps_s) == min(round(rate_hz * FRAMES / RATE_HZ), FRAMES)
    if RATE_HZ % rate_hz == 0:
        np.testing.assert_allclose(np.diff(stamps_s), 1 / rate_hz, atol=2e-6)


@given(late_s=st.floats(-0.5, 0.5), begin_s=st.floats(0, 2))
def test_a_late_clock_shifts_the_stamps_of_that_time_alone(late_s, begin_s):
    frames = [RgbdFrame(i / 30, np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2), np.float32), i) for i in range(60)]
    ticks = [WheelTicks(i / 50, i, i) for i in range(100)]
    stream: list[Event] = sorted([*frames, *ticks], key=lambda event: event.stamp_s)
    shifted = list(LateClock(late_s=late_s, begin_s=begin_s).apply(stream))
    assert [e.stamp_s for e in shifted] == sorted(e.stamp_s for e in shifted)
    for frame in frames_of(shifted):
        true_s = frame.index / 30
        assert frame.stamp_s == true_s + (late_s if true_s >= begin_s else 0.0)
    assert len(shifted) == len(stream)


def test_a_late_clock_holds_back_no_more_than_it_must(events):
    """So that it serves a stream that never ends."""
    seen = []

    def endless():
        for event in events:
            seen.append(event)
            yield event

    shifted = LateClock(late_s=0.03).apply(endless())
    for reported in shifted:
        assert seen[-1].stamp_s - reported.stamp_s < 0.04
        if len(seen) == len(events):
            break


def test_a_stuck_image_comes_again_with_new_stamps(events):
    original = {e.index: e for e in frames_of(events)}
    for frame in frames_of(StuckImage(begin_s=1.0, end_s=2.0).apply(events)):
        shown = original[29] if 1.0 <= frame.stamp_s < 2.0 else original[frame.index]
        assert frame.color is shown.color
        assert frame.depth_m is shown.depth_m
        assert frame.stamp_s == original[frame.index].stamp_s
    from_the_start = frames_of(StuckImage().apply(events))
    assert all(frame.color is original[0].color for frame in from_the_start)


def test_several_faults_lie_over_one_another(events):
    together = list(events_with((LowRate(rate_hz=10.0), Covered(begin_s=1.0, end_s=2.0), LateClock()), events))
    frames = [e for e in together if isinstance(e, RgbdFrame | SkippedFrame)]
    assert len(frames) == 30
    covered = [e for e in frames_of(together) if not e.depth_m.any()]
    assert [round(e.stamp_s - 0.03, 3) for e in (covered[0], covered[-1])] == [1.0, 1.9]
    assert list(events_with((), events)) == events


@pytest.mark.parametrize(
    "make",
    [
        lambda: DepthHoles(blobs=1.1),
        lambda: DepthHoles(speckle=-0.1),
        lambda: FramesDropped(share=math.nan),
        lambda: LowRate(rate_hz=0.0),
        lambda: LowRate(rate_hz=math.inf),
        lambda: replace(LowRate(), rate_hz=-1.0),
    ],
)
def test_numbers_that_mean_nothing_are_refused(make):
    with pytest.raises(ConfigError):
        make()
