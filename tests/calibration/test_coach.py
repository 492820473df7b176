"""The coach: what is missing is asked for, and what was shown is asked for no more."""

from __future__ import annotations

import numpy as np
import pytest
from calibration.drawn_boards import pose

from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.settings.calibration import CoachSettings
from wheelsight_calibration.board import board_from
from wheelsight_calibration.live_views import advise, covered_share, largest_tilt_deg
from wheelsight_calibration.views import Corners

BOARD = board_from("9x6:25mm")
CAMERA = PinholeCamera(640, 480, 556.8, 556.8, 319.5, 239.5)
SIZE = (640, 480)


def seen(z: float, tilt_deg: tuple[float, float] = (0, 0), at_m: tuple[float, float] = (0, 0)) -> Corners:
    px, _ = CAMERA.project(se3.apply(pose(BOARD, z, tilt_deg, at_m), BOARD.points_m))
    return Corners(np.arange(BOARD.count), px)


def test_with_nothing_seen_the_whole_board_is_asked_for() -> None:
    assert advise([], BOARD, SIZE).missing == ("the whole board, in the middle of the image",)


def test_one_view_leaves_distances_tilts_and_corners_to_ask_for() -> None:
    advice = advise([seen(0.6)], BOARD, SIZE, lens=CAMERA)
    assert advice.missing[0].startswith("nearer: boards are all 0.6 to 0.6 m away")
    assert "the board in the upper left corner of the image" in advice.missing
    assert sum("nearer to the camera" in word for word in advice.missing) == 4
    assert str(advice).startswith("next: nearer")


# About x, then y: a positive turn about y brings the right side nearer, one about x the upper edge away.
@pytest.mark.parametrize(
    ("tilt_deg", "side"),
    [((30, 0), "lower edge"), ((-30, 0), "upper edge"), ((0, 30), "left side"), ((0, -30), "right side")],
)
def test_the_side_that_was_nearer_is_no_longer_asked_for(tilt_deg: tuple[float, float], side: str) -> None:
    T = pose(BOARD, 0.6, tilt_deg)
    points = se3.apply(T, BOARD.points_m).reshape(6, 9, 3)[..., 2]
    depths = {
        "lower edge": points[-1].mean(),
        "upper edge": points[0].mean(),
        "left side": points[:, 0].mean(),
        "right side": points[:, -1].mean(),
    }
    nearest = min(depths, key=lambda name: depths[name])
    asked = [word for word in advise([seen(0.6, tilt_deg)], BOARD, SIZE, lens=CAMERA).missing if "nearer to" in word]
    assert len(asked) == 3
    assert not any(nearest in word for word in asked)


def test_a_full_set_needs_nothing_but_numbers() -> None:
    views = [seen(0.35), seen(0.9)]
    views += [seen(0.6, tilt) for tilt in ((30, 0), (-30, 0), (0, 30), (0, -30))]
    views += [seen(0.6, at_m=(x, y)) for x in (-0.24, 0.0, 0.24) for y in (-0.18, 0.0, 0.18)]
    few = advise(views, BOARD, SIZE, lens=CAMERA)
    assert few.missing == (f"more like these: {len(views)} of 20 views",)
    assert not advise(views, BOARD, SIZE, CoachSettings(enough=10), CAMERA).missing
    assert (few.nearest_m, few.farthest_m) == pytest.approx((0.35, 0.9), rel=0.2)


def test_cover_and_tilt() -> None:
    assert covered_share([np.array([[0.0, 0.0], [639.0, 479.0], [1.0, 1.0]])], SIZE) == 2 / 48
    T = np.stack([pose(BOARD, 1.0, (20, 0)), pose(BOARD, 1.0, (-15, 0))])
    assert largest_tilt_deg(T) == pytest.approx(35)
