"""Walls whose paint repeats: keypoints agree a period farther on, or upside down, and the pose stays right."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import cycle

import numpy as np
import pytest
from grids import mostly_slow

from wheelsight import Calibration, Config, Event, Localizer, PinholeCamera, RgbdFrame, Status, Wheels, WheelTicks
from wheelsight.core.geometry import FloatArray, se3

_CAMERA = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
_T_BASE_CAMERA = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1.0]])
_RADIUS_M, _TRACK_M, _TICKS = 0.1, 0.4, 4000.0
_WALL_M = 3.0  # ahead of where the robot begins
_RIGHT_M, _RIGHT_RAD = 0.15, 0.15  # a period is 0.24 m at least

Paint = Callable[[FloatArray, FloatArray], FloatArray]


def _waves(across: FloatArray, up: FloatArray) -> FloatArray:
    """The same upside down."""
    return 128 + 50 * np.sin(9 * across) + 50 * np.sin(11 * up + 4 * across)


def _fine_waves(across: FloatArray, up: FloatArray) -> FloatArray:
    return 128 + 60 * np.sin(20 * across) + 50 * np.sin(17 * up)


def _checker(across: FloatArray, up: FloatArray) -> FloatArray:
    return 60 + 140 * ((np.floor(across / 0.15) + np.floor(up / 0.15)) % 2)


def _stripes(across: FloatArray, up: FloatArray) -> FloatArray:
    return 60 + 140 * (np.floor(across / 0.12) % 2) + 0 * up


def _bricks(across: FloatArray, up: FloatArray) -> FloatArray:
    along = (across + 0.12 * (np.floor(up / 0.08) % 2)) % 0.24
    return np.where((along < 0.015) | (up % 0.08 < 0.015), 200.0, 90.0)


_PAINTS = {"waves": _waves, "fine waves": _fine_waves, "checker": _checker, "stripes": _stripes, "bricks": _bricks}
_SPEEDS: dict[str, Callable[[float], tuple[float, float]]] = {
    "straight": lambda t_s: (0.4 if t_s < 3 else -0.3, 0.0),
    "turning": lambda t_s: (0.1, 0.5 * float(np.sin(2 * t_s))),
    "quick": lambda t_s: (0.5 * float(np.sin(t_s)), 1.2 * float(np.sin(3 * t_s))),
}


def _drive(paint: Paint, speeds: Callable[[float], tuple[float, float]]) -> Iterator[tuple[Event, FloatArray]]:
    """Events and where the base truly is, (4, 4): 50 readings and 10 frames a second, at rest for the first one."""
    rng, step_s = np.random.default_rng(1), 0.02
    T_map_base, turned_m = np.eye(4), np.zeros(2)
    for step in range(300):
        stamp_s = step * step_s
        ticks = np.rint(turned_m / (2 * np.pi * _RADIUS_M) * _TICKS).astype(int)
        yield WheelTicks(stamp_s, int(ticks[0]), int(ticks[1])), T_map_base
        if step % 5 == 0:
            yield _seen(T_map_base @ _T_BASE_CAMERA, paint, stamp_s, step // 5, rng), T_map_base
        v, w = speeds(stamp_s - 1.0) if stamp_s >= 1.0 else (0.0, 0.0)
        turned_m = turned_m + step_s * np.array([v - w * _TRACK_M / 2, v + w * _TRACK_M / 2])
        T_map_base = T_map_base @ se3.exp(step_s * np.array([v, 0, 0, 0, 0, w]))


def _seen(T_map_camera: FloatArray, paint: Paint, stamp_s: float, index: int, rng: np.random.Generator) -> RgbdFrame:
    rows, columns = np.mgrid[0:120, 0:160]
    rays = np.stack([(columns - 79.5) / 130, (rows - 59.5) / 130, np.ones((120, 160))], -1) @ T_map_camera[:3, :3].T
    depth_m = (_WALL_M - T_map_camera[0, 3]) / rays[..., 0]
    _, across, up = np.moveaxis(T_map_camera[:3, 3] + rays * depth_m[..., None], -1, 0)
    grey = np.clip(paint(across, up) + rng.normal(0, 2, across.shape), 0, 255).astype(np.uint8)
    measured_m = (depth_m * (1 + rng.normal(0, 0.002, depth_m.shape))).astype(np.float32)
    return RgbdFrame(stamp_s, np.repeat(grey[..., None], 3, axis=2), measured_m, index)


@pytest.mark.parametrize(
    ("paint", "way"),
    mostly_slow(
        [*zip(_PAINTS, cycle(_SPEEDS), strict=False), ("checker", "turning")],
        [("waves", "straight"), ("checker", "turning")],
    ),
)
def test_paint_that_repeats_moves_no_map(paint: str, way: str) -> None:
    wheels = Wheels(_RADIUS_M, _RADIUS_M, _TRACK_M, _TICKS)
    calibration = Calibration.registered_camera(_CAMERA, T_base_camera=_T_BASE_CAMERA, wheels=wheels)
    tracked = 0
    with Localizer(calibration, Config().with_odometry(("wheels", "dense"))) as localizer:
        for event, T_map_base in _drive(_PAINTS[paint], _SPEEDS[way]):
            answer = localizer.process(event)
            if answer is None or answer.status is not Status.TRACKING or answer.T_map_body is None:
                continue
            tracked += 1
            off = se3.log(se3.invert(T_map_base) @ se3.nearest(answer.T_map_body))
            assert np.linalg.norm(off[:3]) < _RIGHT_M, f"{answer.stamp_s:.2f} s"
            assert np.linalg.norm(off[3:]) < _RIGHT_RAD, f"{answer.stamp_s:.2f} s"
    assert tracked > 200  # of 360 events
