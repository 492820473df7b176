from __future__ import annotations

import base64
from dataclasses import replace

import cv2
import numpy as np
import pytest
from run_example import example_picture

from wheelsight_report import draw_matches
from wheelsight_report.pictures import INLIER_RGB, OUTLIER_RGB, webp_uri

BLACK = np.zeros((240, 320, 3), np.uint8)


def _one_match(is_inlier: bool):
    pixel = np.array([[100.0, 60.0]])
    return replace(example_picture(BLACK, 0), px=pixel + (40, 50), reference_px=pixel, is_inlier=np.array([is_inlier]))


@pytest.mark.parametrize(("is_inlier", "colour"), [(True, INLIER_RGB), (False, OUTLIER_RGB)])
def test_a_match_is_joined_in_its_colour(is_inlier: bool, colour: tuple[int, int, int]) -> None:
    image = draw_matches(_one_match(is_inlier))
    assert image.shape == (240, 320 + 6 + 320, 3)
    middle_x, middle_y = (100 + 320 + 6 + 140) // 2, (60 + 110) // 2
    near = image[middle_y - 1 : middle_y + 2, middle_x].astype(int)
    assert abs(near - colour).sum(axis=1).min() < 60
    other = OUTLIER_RGB if is_inlier else INLIER_RGB
    assert not (image == other).all(axis=2).any()


def test_both_ends_are_marked() -> None:
    image = draw_matches(_one_match(True))
    for x, y in ((100, 60), (140 + 326, 110)):
        patch = image[y - 5 : y + 6, x - 5 : x + 6]
        assert (patch == INLIER_RGB).all(axis=2).any()


def test_images_are_left_as_they_were() -> None:
    picture = example_picture()
    before = picture.color.copy()
    draw_matches(picture)
    np.testing.assert_array_equal(picture.color, before)


def test_large_images_are_drawn_smaller_and_unequal_ones_side_by_side() -> None:
    picture = example_picture(np.zeros((1080, 1920, 3), np.uint8), 5)
    image = draw_matches(replace(picture, reference_color=BLACK))
    assert image.shape == (360, 320 + 6 + 640, 3)


def test_no_matches_and_matches_that_are_not_finite() -> None:
    empty = example_picture(BLACK, 0)
    assert not np.isin(draw_matches(empty)[:, :320], (INLIER_RGB[1],)).any()
    holed = _one_match(True)
    holed.px[0] = np.nan
    np.testing.assert_array_equal(draw_matches(holed), draw_matches(empty))


def test_the_page_gets_a_jpeg() -> None:
    picture = example_picture()
    kind, data = webp_uri(draw_matches(picture)).split(",")
    assert kind == "data:image/webp;base64"
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == draw_matches(picture).shape
    assert abs(image[..., ::-1].astype(int) - draw_matches(picture)).mean() < 25
