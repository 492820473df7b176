"""Views from a live camera: what stands still and is new is taken, what moves, or was there, is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibration.drawn_boards import pose, seen_board

from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.settings.calibration import CoachSettings
from wheelsight_calibration.board import board_from
from wheelsight_calibration.live_views import ViewTaker, save_view
from wheelsight_calibration.views import read_views

BOARD = board_from("9x6:35mm")
CAMERA = PinholeCamera(320, 240, 265.0, 265.0, 161.0, 118.0)


def frame(stamp_s: float, T: np.ndarray | None) -> RgbdFrame:
    """Of a board, red where it is lit; or of a bare wall."""
    grey = np.full((240, 320), 120, np.uint8) if T is None else seen_board(BOARD, CAMERA, T)
    color = np.stack([grey, grey, grey // 2], axis=-1)
    return RgbdFrame(stamp_s, color, np.full((240, 320), 0.6, np.float32))


def test_a_view_is_taken_once_it_has_stood_still() -> None:
    taker, T = ViewTaker(BOARD, CAMERA), pose(BOARD, 0.6)
    assert taker.add(frame(0.0, T)) == "hold still"
    assert taker.add(frame(0.3, T)) == "hold still"
    assert taker.add(frame(0.5, T)) == ""
    assert taker.add(frame(1.5, T)) == "such a view is there already: move the board"
    assert len(taker.seen) == 1


def test_a_board_that_creeps_or_goes_away_has_not_stood_still() -> None:
    taker = ViewTaker(BOARD, CAMERA)
    for number in range(6):  # 1.3 px from one frame to the next
        assert taker.add(frame(0.3 * number, pose(BOARD, 0.6, at_m=(0.003 * number, 0)))) == "hold still"
    still = pose(BOARD, 0.6, at_m=(0.015, 0))
    assert taker.add(frame(1.7, None)) == "no whole board is seen"
    assert taker.add(frame(2.0, still)) == "hold still"
    assert taker.add(frame(2.5, still)) == ""


def test_it_ends_when_nothing_is_missing_and_more_are_asked_for_where_that_was_not_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in (("COLUMNS", 1), ("ROWS", 1), ("NEAR_FAR", 1.1), ("TILT_DEG", 1.0), ("MORE_VIEWS", 2)):
        monkeypatch.setattr(f"wheelsight_calibration.live_views._{name}", value)
    taker = ViewTaker(BOARD, CAMERA, CoachSettings(enough=3))
    poses = [pose(BOARD, z, tilt) for z, tilt in ((0.5, (10, 10)), (0.6, (-10, -10)), (0.7, (10, -10)))]
    for number, T in enumerate(poses):
        assert not taker.has_enough()
        assert [taker.add(frame(number + s, T)) for s in (0.0, 0.5)] == ["hold still", ""]
    assert taker.has_enough()
    taker.ask_more()
    assert not taker.has_enough()
    for number, z in enumerate((0.9, 0.4)):
        assert [taker.add(frame(9 + number + s, pose(BOARD, z))) for s in (0.0, 0.5)] == ["hold still", ""]
    assert taker.has_enough()


def test_a_view_is_written_as_it_is_read_and_beside_those_before(tmp_path: Path) -> None:
    shown, folder = frame(0.0, pose(BOARD, 0.6)), tmp_path / "views"
    infrared = (shown.color[..., 0].astype(np.uint16)) * 200
    assert [save_view(folder, shown, infrared), save_view(folder, shown)] == ["001", "002"]
    seen = read_views([folder], BOARD)
    assert [view.name for view in seen.views] == ["001", "002"]
    first, second = seen.views
    assert first.reading is not None
    assert first.reading == pytest.approx(0.6)
    assert first.infrared is not None
    assert second.infrared is None
    taken = ViewTaker(BOARD, CAMERA, seen=[first.color])
    assert taken.add(shown) == "such a view is there already: move the board"
