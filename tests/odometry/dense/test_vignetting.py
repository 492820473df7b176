"""A lens's vignetting is learned from plain walls, whatever the exposure; evened frames no longer tilt the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from narrowing import not_none
from odometry.dense.scenes import SMALL, Plane, bench, dense, frame_of
from odometry.views import run

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense.odometry import Vignetting

ROOM = [
    Plane((0, 0, 1), 4.0),
    Plane((1, 0, 0), 1.2),
    Plane((-1, 0, 0), 1.0),
    Plane((0, 1, 0), 0.9, is_painted=True),
]
COSINE4 = (1 + (SMALL.rays()[..., :2] ** 2).sum(axis=-1)) ** -2.0


def behind_lens(frame: RgbdFrame, exponent: float, gain: float = 1.0) -> RgbdFrame:
    """The frame as a lens with such vignetting shows it, at another exposure."""
    grey = gain * COSINE4[..., None] ** exponent * frame.color
    return replace(frame, color=np.rint(grey).clip(0, 255).astype(np.uint8))


def learned(exponent: float, poses: list[FloatArray], gain: float = 1.0, evened: float = 0.0) -> Vignetting:
    """What is learned from frames at poses, each against the one before, if they are evened from the second on."""
    parts = bench()
    vignetting, reference = Vignetting(parts.gridder), None
    for number, T in enumerate(poses):
        seen = frame_of(ROOM, T, 0.1 * number, noise_seed=number)
        frame = parts.grid(behind_lens(seen, exponent, gain**number))
        if reference is not None:
            vignetting.learn(frame, T, reference)
            parts.gridder.even(evened)
        reference = parts.maker.of_frame(frame, T)
    return vignetting


TURNS = [se3.exp([0.05 * k, 0, 0.1 * k, 0, 0.12 * (-1) ** k, 0]) for k in range(6)]


@pytest.mark.parametrize("gain", [1.0, 0.96], ids=["same exposure", "darker each time"])
@pytest.mark.parametrize("exponent", [0.0, 0.2, 0.45])
def test_vignetting_is_learned_whatever_the_exposure(exponent: float, gain: float) -> None:
    vignetting = learned(exponent, TURNS, gain)
    assert vignetting.exponent == pytest.approx(exponent, abs=0.03)


def test_what_is_evened_already_teaches_the_same() -> None:
    assert learned(0.3, TURNS, evened=0.5).exponent == pytest.approx(0.3, abs=0.03)


def test_who_stands_still_learns_nothing() -> None:
    assert learned(0.3, [np.eye(4)] * 4).exponent == pytest.approx(0.0, abs=1e-3)


def test_an_evened_wall_is_even() -> None:
    parts = bench()
    wall = behind_lens(frame_of([Plane((0, 0, 1), 2.0)], np.eye(4), 0.0), 0.3)
    assert np.ptp(parts.grid(wall).levels[0].grey) > 20
    parts.gridder.even(0.3)
    assert np.ptp(parts.grid(wall).levels[0].grey) < 2
    parts.gridder.even(1.0)
    assert parts.grid(wall).levels[0].grey.max() <= 255


@pytest.mark.slow
def test_odometry_learns_its_camera() -> None:
    poses = [se3.exp([0, 0, 0.04 * k, 0, 0.02 * k, 0]) for k in range(40)]
    frames = [behind_lens(frame_of(ROOM, T, k / 15, noise_seed=k), 0.3) for k, T in enumerate(poses)]
    odometry = dense()
    assert not_none(run(odometry, frames)[-1].frame).vignetting == pytest.approx(0.3, abs=0.06)
