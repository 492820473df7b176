"""MapBuilder: what tracked frames leave in the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from numpy.testing import assert_array_equal
from odometry.dense.scenes import SMALL, Plane, frame_of

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, Estimate, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation.camera_localizer import ByFrames
from wheelsight.mapping import SurfelSettings
from wheelsight.mapping.surfels import MapBuilder, Thinning
from wheelsight.vision.dense import DenseOdometry

TRUTH = synthetic.wobbling_trajectory(6)


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    poses = zip(TRUTH.stamps_s, TRUTH.T_frame_body, strict=True)
    return [RgbdFrame(float(stamp_s), *synthetic.render_room(T)) for stamp_s, T in poses]


class Mapped:
    """A camera alone, tracked against the map that it builds.

    `fused`: whether the last frame was.
    """

    def __init__(self, calibration: Calibration, **settings: float) -> None:
        overrides = {f"surfels.{name}": value for name, value in settings.items()}
        self._way = ByFrames(calibration, load_config(overrides={"odometry": "dense", "map": "surfels"} | overrides))
        assert isinstance(self._way.odometry, DenseOdometry)
        assert self._way.mapper is not None
        self.odometry, self.builder, self.fused = self._way.odometry, self._way.mapper, False

    def process(self, frame: RgbdFrame) -> Estimate:
        before = self.builder.map.frames
        estimate, _ = self._way.process(frame)
        assert estimate is not None
        self.fused = self.builder.map.frames > before
        return estimate


def mapped() -> Mapped:
    """That fuses every frame."""
    return Mapped(Calibration.registered_camera(synthetic.CAMERA), fused_way_m=0)


def dark(frame: RgbdFrame) -> RgbdFrame:
    return replace(frame, color=np.full_like(frame.color, 3))


def looks(subject: Mapped) -> dict[tuple[float, ...], int]:
    """Colour and grey (4,) of the surfels, which the dark is not to change, and how often each occurs."""
    surfels = subject.builder.map.surfels()
    values, counts = np.unique(np.column_stack([surfels.color, surfels.grey]), axis=0, return_counts=True)
    return {tuple(value): int(count) for value, count in zip(values, counts, strict=True)}


def test_the_map_has_the_colours_of_the_frames(frames: list[RgbdFrame]) -> None:
    subject = mapped()
    for frame in frames:
        assert subject.process(frame).status is Status.TRACKING
    view = subject.builder.map.render(np.eye(4), subject.odometry.intrinsics, frames[0].depth_m.shape)
    there = (view.depth_m > 0) & (view.color[..., 0] >= 0)
    assert there.mean() > 0.9
    assert np.median(np.abs(view.color - frames[0].color)[there]) < 8


def test_dark_frames_change_no_colour(frames: list[RgbdFrame]) -> None:
    subject = mapped()
    subject.process(frames[0])
    before = looks(subject)
    for frame in frames[1:]:
        assert subject.process(dark(frame)).status is Status.TRACKING
        assert subject.fused
    unknown = (-1.0, -1.0, -1.0, -1.0)
    after = looks(subject)
    # Surfels may die, and new ones know no colour; none has a colour that was not there in the light.
    assert all(count <= before[look] for look, count in after.items() if look != unknown)
    assert sum(count for look, count in after.items() if look != unknown) > 0.8 * sum(before.values())


def test_light_gives_colour_to_what_was_found_in_the_dark(frames: list[RgbdFrame]) -> None:
    subject = mapped()
    for frame in frames[:3]:
        subject.process(dark(frame))
    assert_array_equal(subject.builder.map.surfels().color, -1)
    for frame in frames[3:]:
        subject.process(frame)
    assert np.mean(subject.builder.map.surfels("all").grey >= 0) > 0.8


def test_what_shows_only_part_of_the_motion_teaches_the_map_nothing() -> None:
    """Along a plain wall no one knows the way; where the pose is partly a guess, frames would smear the map."""
    subject = Mapped(Calibration.registered_camera(SMALL))
    fused, unseen = [], []
    for k in range(12):
        estimate = subject.process(frame_of([Plane((0, 0, 1), 1.5)], np.eye(4), k / 30, noise_seed=k))
        fused.append(subject.fused)
        if k > 0 and estimate.status is Status.TRACKING:
            assert isinstance(estimate, CameraEstimate)
            unseen.append(estimate.motion.degenerate)
    assert fused[0]
    assert not any(fused[1:])
    assert unseen
    assert all(directions is not None and len(directions) for directions in unseen)


def test_a_frame_goes_to_where_others_have_it(frames: list[RgbdFrame]) -> None:
    """Odometry shows what the frame shows; where that is, who joins it with wheels may know better."""
    calibration, T_reported = Calibration.registered_camera(synthetic.CAMERA), se3.exp([3.0, -2.0, 1.0, 0.2, -0.3, 0.4])
    odometry = DenseOdometry(calibration)
    subject = MapBuilder(odometry, calibration)
    reported = replace(odometry.process(frames[0]), T_odom_body=T_reported)
    assert len(subject.map) == 0
    fused = subject.fuse_tracked(frames[0], reported)
    assert fused is not None
    assert fused.added == len(subject.map) > 10_000
    assert odometry.stage_seconds["fuse"] > 0
    surfels = subject.map.surfels()
    seen = se3.apply(se3.invert(T_reported), surfels.position)
    u, v = (odometry.intrinsics[:2] * seen[:, :2] / seen[:, 2:] + odometry.intrinsics[2:]).T
    inside = (u > 2) & (u < 317) & (v > 2) & (v < 237)
    there = frames[0].depth_m[np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)]
    assert inside.mean() > 0.9
    assert np.median(np.abs(seen[inside, 2] - there)) < 2e-3


@pytest.mark.parametrize(
    ("way_m", "turn_rad", "step_s", "expected"),
    [
        (0.0, 0.0, 0.04, "1--3--3--3"),
        (0.015, 0.0, 0.01, "1--3--3--3"),
        (0.0, 0.015, 0.01, "1-2-2-2-2-"),
        (0.05, 0.0, 0.01, "1111111111"),
        (0.0, 0.0, 0.2, "1111111111"),
    ],
)
def test_frames_that_hardly_move_are_thinned_out(way_m: float, turn_rad: float, step_s: float, expected: str) -> None:
    """By the default settings: 4 cm, a turn by a radian as 1.5 m, and a frame in a tenth of a second at least."""
    subject = Thinning(SurfelSettings())
    poses = [se3.exp([0.0, k * way_m, 0.0, 0.0, 0.0, k * turn_rad]) for k in range(10)]
    counts = [subject.count(T, 100.0 + k * step_s) for k, T in enumerate(poses)]
    assert "".join(str(count) if count else "-" for count in counts) == expected


def test_a_camera_that_stands_still_fuses_some_frames(frames: list[RgbdFrame]) -> None:
    calibration = Calibration.registered_camera(synthetic.CAMERA)
    odometry = DenseOdometry(calibration)
    subject = MapBuilder(odometry, calibration)
    for k in range(30):
        frame = replace(frames[0], stamp_s=k / 30)
        estimate = odometry.process(frame)
        assert estimate.T_odom_body is not None
        subject.fuse_tracked(frame, estimate)
    assert 8 <= subject.map.frames <= 11
