from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.errors import MapError
from wheelsight.slam.maps import keyframes as images
from wheelsight.slam.maps.keyframes import DepthSteps, grey_numbers, grey_of


@given(
    depth_m=st.floats(0.001, 13.0),
    constant_m=st.floats(0, 0.1),
    quadratic_per_m=st.floats(1e-6, 0.1),
)
def test_steps_of_depth_are_a_share_of_its_noise(depth_m: float, constant_m: float, quadratic_per_m: float) -> None:
    steps = DepthSteps.of_noise(DepthNoise(constant_m, quadratic_per_m))
    (here,) = steps.numbers(np.array([depth_m], np.float32))
    below, at, above = steps.depth_m(np.array([max(here, 1) - 1, here, here + 1], np.uint16))
    step_m = max(2 * constant_m, 0.0004) + 2 * quadratic_per_m * float(at) ** 2
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


@pytest.mark.parametrize("known", [0.0, 0.5, 1.0])
def test_images_come_back_to_the_last_bit(rng: np.random.Generator, known: float) -> None:
    """Depth that leaps from one end of 16 bits to the other, too."""
    depth = np.where(rng.random((24, 32)) < known, rng.choice([1, 2, 300, 65_535], (24, 32)), 0).astype(np.uint16)
    assert_array_equal(images.unpacked_depth(images.packed_depth(depth)), depth)
    grey = rng.integers(0, 256, (24, 32)).astype(np.uint8)
    assert_array_equal(images.unpacked_grey(images.packed_grey(grey)), grey)


def test_depth_that_is_none_is_refused() -> None:
    """Steps that lead below 1."""
    reported = np.zeros((4, 4, 3), np.uint8)
    reported[..., 1] = 2
    code = cv2.imencode(".webp", reported, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    with pytest.raises(MapError, match="its depth is out of range"):
        images.unpacked_depth(code)


def test_an_image_with_loss_is_none_of_a_map() -> None:
    lossy = cv2.imencode(".webp", np.zeros((8, 8, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 80])[1].tobytes()
    with pytest.raises(MapError, match="an image of it cannot be read"):
        images.unpacked_grey(lossy)
