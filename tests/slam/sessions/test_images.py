from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.calibration import DepthNoise
from wheelsight.slam.sessions.images import DepthSteps, grey_numbers, grey_of


@given(
    depth_m=st.floats(0.001, 13.0),
    constant_m=st.floats(0, 0.1),
    quadratic_per_m=st.floats(1e-6, 0.1),
    sigmas=st.floats(0.1, 2),
)
def test_steps_of_depth_are_a_share_of_its_noise(
    depth_m: float, constant_m: float, quadratic_per_m: float, sigmas: float
) -> None:
    steps = DepthSteps.of_noise(DepthNoise(constant_m, quadratic_per_m), sigmas)
    (here,) = steps.numbers(np.array([depth_m], np.float32))
    below, at, above = steps.depth_m(np.array([max(here, 1) - 1, here, here + 1], np.uint16))
    step_m = max(sigmas * constant_m, 0.0004) + sigmas * quadratic_per_m * float(at) ** 2
    assert below <= depth_m * (1 + 1e-5)
    assert abs(float(at) - depth_m) <= max(float(above - at), step_m)
    if step_m < 0.02 * depth_m:  # elsewhere a step is no differential
        assert float(above - below) == pytest.approx(2 * step_m, rel=0.1)


@given(step=st.integers(1, 32))
def test_grey_that_is_known_stays_known(step: int) -> None:
    grey = np.arange(256, dtype=np.float32)
    numbers = grey_numbers(grey, step)
    back = grey_of(numbers, step)
    assert ((back > 0) == (grey > 0)).all()
    assert (np.abs(back - grey)[grey >= step / 2] <= step / 2).all()
    assert (grey_numbers(back, step) == numbers).all()
    assert (grey_numbers(np.full(1, -1, np.float32), step) == 0).all()
