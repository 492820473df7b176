"""Wrong events and arrays end in one typed line that says what was expected, never in OpenCV or a kernel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from synthetic import CAMERA, render_room, wobbling_trajectory

from wheelsight import Calibration, Config, Localizer, RgbdFrame, Wheels, WheelTicks, YawRate
from wheelsight.config import load_config
from wheelsight.core.areas import Area, AreaMap
from wheelsight.core.errors import ArgumentError
from wheelsight.estimation import AreaRectifier, Weights
from wheelsight.vision.dense import DenseOdometry
from wheelsight.vision.features import FeatureOdometry
from wheelsight.wheels import WheelOdometry
from wheelsight_papers import PaperRectifier

CALIBRATION = Calibration.registered_camera(CAMERA, wheels=Wheels(0.17, 0.17, 0.5, 3200.0), T_base_camera=np.eye(4))
FRAME = RgbdFrame(1.0, *render_room(wobbling_trajectory(1).T_frame_body[0]))
AREAS = AreaMap((Area("hall", np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), x_m=0.5),))
WRONG_FRAMES = (
    ({"color": FRAME.color[..., 0]}, r"color is of shape \(240, 320\), not \(240, 320, 3\)"),
    ({"color": FRAME.color[::2]}, r"color is of shape \(120, 320, 3\), not \(240, 320, 3\)"),
    ({"color": FRAME.color.astype(float)}, r"color is of float64, not uint8"),
    ({"color": None}, "color is None, not an array"),
    ({"depth_m": FRAME.depth_m[None]}, r"depth_m is of shape \(1, 240, 320\), not \(240, 320\)"),
    ({"depth_m": (1000 * FRAME.depth_m).astype(np.uint16)}, "depth_m is of uint16, not float32"),
    ({"depth_m": FRAME.depth_m.tolist()}, "depth_m is a list, not an array"),
    ({"stamp_s": "1.0"}, "stamp_s of RgbdFrame is a str, not a number"),
)


@pytest.mark.parametrize(("change", "reported"), WRONG_FRAMES)
@pytest.mark.parametrize("odometry", ["features", "dense", "wheels,dense"])
def test_a_localizer_refuses_images_that_are_none(odometry: str, change: dict[str, Any], reported: str) -> None:
    localizer = Localizer(CALIBRATION, load_config(overrides={"odometry": odometry}))
    with pytest.raises(ArgumentError, match=reported):
        localizer.process(replace(FRAME, **change))


@pytest.mark.parametrize(("change", "reported"), WRONG_FRAMES)
@pytest.mark.parametrize("kind", [FeatureOdometry, DenseOdometry])
def test_so_does_an_odometry(kind: Callable[..., Any], change: dict[str, Any], reported: str) -> None:
    with pytest.raises(ArgumentError, match=reported):
        kind(CALIBRATION).process(replace(FRAME, **change))


@pytest.mark.parametrize("event", [None, 1.0, "frame", np.zeros((2, 2)), RgbdFrame])
def test_what_is_no_event_is_refused(event: Any) -> None:
    with pytest.raises(ArgumentError, match=r"is no event \(give one of RgbdFrame, WheelTicks"):
        Localizer(CALIBRATION, Config()).process(event)


@pytest.mark.parametrize(
    ("event", "reported"),
    [
        (WheelTicks(None, 1, 2), "stamp_s of WheelTicks is None"),  # type: ignore[arg-type]
        (WheelTicks(0.0, "1", 2), "left of WheelTicks is a str"),  # type: ignore[arg-type]
        (WheelTicks(0.0, 1, np.array([2])), "right of WheelTicks is a ndarray"),  # type: ignore[arg-type]
        (YawRate(0.0, [1.0]), "yaw_rate_rad_s of YawRate is a list"),  # type: ignore[arg-type]
    ],
)
def test_numbers_that_are_none_are_refused(event: Any, reported: str) -> None:
    with pytest.raises(ArgumentError, match=reported):
        Localizer(CALIBRATION, load_config(overrides={"odometry": "wheels"})).process(event)


def test_numbers_of_numpy_are_numbers() -> None:
    localizer = Localizer(CALIBRATION, load_config(overrides={"odometry": "wheels"}))
    assert localizer.process(WheelTicks(np.float64(1.0), np.int32(3), np.int64(4))) is not None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("prior", "reported"),
    [
        (np.eye(3), r"is of shape \(3, 3\), not \(4, 4\)"),
        ("there", "is a str, not"),
        (np.full((4, 4), np.nan), "has numbers that are not finite"),
        (2 * np.eye(4), "is not a rigid motion"),
    ],
)
@pytest.mark.parametrize("kind", [FeatureOdometry, DenseOdometry])
def test_motions_that_are_none_are_refused(kind: Callable[..., Any], prior: Any, reported: str) -> None:
    with pytest.raises(ArgumentError, match="prior " + reported):
        kind(CALIBRATION).process(FRAME, prior)
    with pytest.raises(ArgumentError, match="T_map_camera " + reported):
        kind(CALIBRATION).restart(FRAME, prior, np.eye(6))
    with pytest.raises(ArgumentError, match=r"covariance is of shape \(3, 3\), not \(6, 6\)"):
        kind(CALIBRATION).restart(FRAME, np.eye(4), np.eye(3))


def test_wheel_odometry_takes_readings_alone() -> None:
    odometry = WheelOdometry(CALIBRATION.wheels)  # type: ignore[arg-type]
    for wrong in (None, YawRate(0.0, 1.0)):
        with pytest.raises(ArgumentError):
            odometry.process(wrong)  # type: ignore[arg-type]


def test_rectifiers_take_steps_alone() -> None:
    paper = PaperRectifier(AREAS, np.eye(4), Weights())
    with pytest.raises(ArgumentError, match=r"T_before_now is of shape \(3, 3\), not \(4, 4\)"):
        paper.predict(np.eye(3))
    with pytest.raises(ArgumentError, match=r"T_odom_base is of shape \(2,\), not \(4, 4\)"):
        PaperRectifier(AREAS, [1, 2], Weights())
    with pytest.raises(ArgumentError, match=r"covariance is of shape \(3, 3\), not \(6, 6\)"):
        AreaRectifier(AREAS, np.eye(4)).predict(np.eye(4), np.eye(3))
