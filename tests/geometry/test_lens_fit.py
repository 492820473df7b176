"""A lens of our own model is found again; one of another model as well as a polynomial can."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.geometry.camera import fitted_lens


def test_brown_is_found_again(rng: np.random.Generator) -> None:
    camera = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5, (0.12, -0.3, 0.002, -0.001, 0.1))
    xy = rng.uniform(-0.6, 0.6, (200, 2))
    distorted = (camera.denormalise(xy) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    found = fitted_lens(xy, distorted)
    np.testing.assert_allclose(found.distortion, camera.distortion, atol=1e-9)
    assert found.worst == pytest.approx(0, abs=1e-12)


def test_what_it_cannot_bend_is_reported(rng: np.random.Generator) -> None:
    xy = rng.uniform(-0.6, 0.6, (200, 2))
    moved = fitted_lens(xy, xy + (0.01, 0.0))
    assert 0.001 < moved.worst < 0.02
    assert 0 < moved.median < moved.worst
