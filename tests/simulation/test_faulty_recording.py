"""A simulated recording with a camera that fails is a recording still."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from narrowing import as_frame

from wheelsight.core.messages import RgbdFrame, WheelTicks
from wheelsight.io.recordings import Recording
from wheelsight_sim import SimulationSettings, simulate
from wheelsight_sim.faults import CableOut, Covered, FramesDropped, LateClock
from wheelsight_sim.simulated_recording import with_camera_faults


@pytest.fixture(scope="module")
def recording():
    return simulate(SimulationSettings(world="square", size=(64, 48), rate_hz=10.0, duration_s=1.5, seed=2))


def test_it_is_a_recording_of_the_same_drive(recording):
    faulty = with_camera_faults(recording, CableOut(begin_s=0.5, end_s=1.0))
    assert isinstance(faulty, Recording)
    assert faulty.ground_truth is recording.ground_truth
    assert faulty.wheel_count == recording.wheel_count
    assert (faulty.name, faulty.warnings) == (recording.name, recording.warnings)


@pytest.mark.parametrize(
    "faults",
    [
        (),
        (CableOut(begin_s=0.5, end_s=1.0),),
        (FramesDropped(share=0.4), LateClock(late_s=0.25), Covered(begin_s=0.2, end_s=0.4)),
    ],
)
def test_it_yields_as_many_frames_as_promised(recording, faults):
    faulty = with_camera_faults(recording, *faults)
    events = list(faulty.events())
    assert sum(isinstance(event, RgbdFrame) for event in events) == faulty.frame_count == faulty.association.pairs
    assert sum(isinstance(event, WheelTicks) for event in events) == faulty.wheel_count
    assert [event.stamp_s for event in events] == sorted(event.stamp_s for event in events)


def test_its_frames_are_those_of_the_recording_spoilt(recording):
    faulty = with_camera_faults(recording, Covered(begin_s=0.5, end_s=1.0))
    for spoilt, event in zip(faulty.events(), recording.events(), strict=True):
        if isinstance(event, RgbdFrame):
            covered = 0.5 <= event.stamp_s < 1.0
            np.testing.assert_array_equal(as_frame(spoilt).depth_m, 0 if covered else event.depth_m)
            assert covered == (as_frame(spoilt).color.max() < 15)


def test_without_images_there_are_readings_alone(recording):
    faulty = with_camera_faults(recording, LateClock())
    assert list(faulty.events(images=False)) == list(recording.events(images=False))


def test_leaving_the_events_stops_the_threads(recording):
    events = with_camera_faults(recording, CableOut(end_s=0.5)).events()
    assert next(event for event in events if isinstance(event, RgbdFrame)).index == 5
    events.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("wheelsight-render")]
