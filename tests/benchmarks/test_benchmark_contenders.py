"""Each contender follows a camera whose motion is known; the peers that register depth answer for the depth camera."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import render_room, wobbling_trajectory

from benchmarks import contenders
from benchmarks.contenders import Contender, frame_to_frame, open3d_slam
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame

CAMERA = PinholeCamera(640, 480, 524.0, 520.0, 322.6, 236.8)
REGISTERED = Calibration.registered_camera(CAMERA)
COLOR_CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 316.0, 242.0)
# Rolled by half a radian, so that a motion of the wrong camera is off by half of it.
T_COLOR_DEPTH = se3.from_parts(so3.exp(np.array([0.0, 0.0, 0.5])), np.array([-0.025, 0.0, 0.002]))
TRUTH = wobbling_trajectory(4)
# Voxels of 20 mm tell nothing of ways as short as this; they go through the same code.
SLAM = (open3d_slam.FINE,)
EVERY = (*contenders.ALL, *SLAM)


def start(contender: Contender, calibration: Calibration) -> contenders.Tracker:
    if "Open3D" in contender.name:
        pytest.importorskip("open3d", reason="Open3D is not installed or cannot be loaded", exc_type=ImportError)
    return contender.start(calibration)


def drift(tracker: contenders.Tracker, frames: list[RgbdFrame]) -> float:
    """By what share of the way travelled the last pose, seen from the first, is off."""
    poses = [tracker.track(tracker.prepare(frame)) for frame in frames]
    assert poses[0] is not None
    assert poses[-1] is not None
    T_first_last = relative(TRUTH.T_frame_body[0], TRUTH.T_frame_body[-1])
    error = relative(T_first_last, relative(poses[0], poses[-1]))
    return float(np.linalg.norm(error[:3, 3]) / np.linalg.norm(T_first_last[:3, 3]))


def allowed(contender: Contender) -> float:
    """What aligns depth alone, against voxels, needs longer ways than this to be exact."""
    return 0.4 if contender in SLAM else 0.25


def relative(T_odom_a: FloatArray, T_odom_b: FloatArray) -> FloatArray:
    return se3.invert(T_odom_a) @ T_odom_b


@pytest.fixture(scope="module")
def frames() -> list[RgbdFrame]:
    return [RgbdFrame(stamp_s, *render_room(T_odom_camera, CAMERA)) for stamp_s, T_odom_camera in TRUTH]


@pytest.fixture(scope="module")
def unregistered_frames() -> list[RgbdFrame]:
    """Depth as its own camera sees it, colour from a camera rolled against it and 25 mm beside it."""
    T_depth_color = se3.invert(T_COLOR_DEPTH)
    return [
        RgbdFrame(stamp_s, render_room(T @ T_depth_color, COLOR_CAMERA)[0], render_room(T, CAMERA)[1])
        for stamp_s, T in TRUTH
    ]


@pytest.mark.parametrize("contender", [c for c in EVERY if not c.registers], ids=lambda c: c.name)
def test_a_contender_follows_the_camera(contender: Contender, frames: list[RgbdFrame]) -> None:
    assert drift(start(contender, REGISTERED), frames) < allowed(contender)


@pytest.mark.parametrize("contender", [c for c in EVERY if c.registers or c in SLAM], ids=lambda c: c.name)
def test_with_depth_registered_the_answer_is_the_depth_cameras(
    contender: Contender, unregistered_frames: list[RgbdFrame]
) -> None:
    calibration = Calibration(COLOR_CAMERA, CAMERA, T_COLOR_DEPTH)
    assert drift(start(contender, calibration), unregistered_frames) < allowed(contender)


def test_names_are_unique_and_found() -> None:
    assert len({contender.name for contender in EVERY}) == len(EVERY)
    assert all(contenders.named(contender.name) is contender for contender in (*EVERY, *contenders.MAPPERS))


class Step(frame_to_frame.FrameToFrame):
    """Goes 1 m along x a frame, but finds no motion into frame 2."""

    def native(self, frame: RgbdFrame) -> RgbdFrame:
        return frame

    def motion(self, previous: RgbdFrame, current: RgbdFrame) -> FloatArray | None:
        if current.index == 2:
            return None
        return se3.from_parts(np.eye(3), np.array([float(current.index - previous.index), 0, 0]))


def test_a_frame_without_motion_has_no_pose_and_the_next_goes_on_from_the_last() -> None:
    image, depth_m = np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32)
    tracker = Step(REGISTERED)
    poses = [tracker.track(tracker.prepare(RgbdFrame(float(i), image, depth_m, i))) for i in range(4)]
    assert [None if T is None else T[0, 3] for T in poses] == [0, 1, None, 3]


def test_peers_get_images_without_distortion() -> None:
    camera = PinholeCamera(320, 240, 262.0, 260.0, 161.3, 118.4, (0.26, -0.95, -0.005, 0.003, 1.16))
    straight = camera.normalise(np.array([40.0, 30.0])) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    depth_m = np.zeros((240, 320), np.float32)
    depth_m[28:33, 38:43] = 2.0
    seen = Step(Calibration.registered_camera(camera)).prepare(
        RgbdFrame(0.0, np.zeros((240, 320, 3), np.uint8), depth_m)
    )
    rows, columns = np.nonzero(seen.depth_m)
    np.testing.assert_allclose((columns.mean(), rows.mean()), straight, atol=1.0)
