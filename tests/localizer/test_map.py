"""The map that a localizer builds on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from room_drive import T_BASE_CAMERA, make_room_drive
from synthetic import make_tum_recording, render_room

from wheelsight.config import load_config
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import open_recording

MAPPED = {"odometry": "dense", "map": "surfels", "surfels.stable_confidence": 2.0, "surfels.fused_way_m": 0.0}


def test_without_a_map_there_is_none(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=2)
    recording = open_recording(tmp_path / "room")
    for overrides in ({}, {"odometry": "dense"}):
        localizer = Localizer(recording.calibration, load_config(overrides=overrides))
        for event in recording.events():
            localizer.process(event)
        assert localizer.map is None


def without_depth(event: RgbdFrame) -> Event:
    return replace(event, depth_m=np.zeros_like(event.depth_m))


def unreadable(event: RgbdFrame) -> Event:
    return SkippedFrame(event.stamp_s, "depth image is cut off", event.index)


def elsewhere(event: RgbdFrame) -> Event:
    """Of another place: nothing in it is where the map has it."""
    color, depth_m = render_room(np.array([[0.0, 0, -1, 0.4], [1, 0, 0, 0], [0, -1, 0, 2.0], [0, 0, 0, 1]]), seed=5)
    return replace(event, color=color, depth_m=0.6 * depth_m)


def late(event: RgbdFrame) -> Event:
    return replace(event, stamp_s=event.stamp_s - 1.0)


@pytest.mark.parametrize("change", [without_depth, unreadable, elsewhere, late], ids=lambda change: change.__name__)
def test_a_frame_that_fails_is_never_fused(tmp_path: Path, change: Callable[[RgbdFrame], Event]) -> None:
    make_tum_recording(tmp_path / "room", frames=6)
    recording, bad = open_recording(tmp_path / "room"), 3
    localizer, fused, sizes = Localizer(recording.calibration, load_config(overrides=MAPPED)), [], [0]
    for index, event in enumerate(recording.events()):
        assert localizer.map is not None
        before = localizer.map.frames
        estimate = localizer.process(change(event) if index == bad and isinstance(event, RgbdFrame) else event)
        assert estimate is not None
        assert (estimate.T_odom_body is None) == (index == bad)
        fused.append(localizer.map.frames > before)
        sizes.append(len(localizer.map))
    assert fused == [index != bad for index in range(6)]
    assert sizes[bad + 1] == sizes[bad]


@pytest.mark.slow
def test_the_map_stands_in_the_world_of_the_poses(tmp_path: Path) -> None:
    """The base begins on the floor at the origin, so the floor lies at z = 0 and faces up."""
    make_room_drive(tmp_path / "drive", frames=4)
    recording = open_recording(tmp_path / "drive")
    localizer = Localizer(recording.calibration, load_config(overrides=MAPPED))
    for event in recording.events():
        localizer.process(event)
    assert localizer.body == "base"
    assert localizer.map is not None
    surfels = localizer.map.surfels("stable")
    level = surfels.normal[:, 2] > 0.99
    floor = level & (np.abs(surfels.position[:, 2]) < 0.1)
    assert floor.sum() > 300
    assert np.median(np.abs(surfels.position[floor, 2])) < 0.01
    assert surfels.position[:, 0].min() > T_BASE_CAMERA[0, 3]
