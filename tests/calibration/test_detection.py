"""Boards in images and folders: corners where they were drawn, and a reason for each image that shows none."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration.drawn_boards import pose, seen_board

from wheelsight.core.errors import RecordingError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight_calibration.board import Board, board_from
from wheelsight_calibration.views import (
    FEWEST_CORNERS,
    Corners,
    as_grey,
    edge_width_px,
    find_corners,
    find_view_files,
    read_views,
)

CAMERA = PinholeCamera(640, 480, 530.0, 530.0, 319.5, 239.5)
CHECKERS, CHARUCO = board_from("9x6:35mm"), board_from("charuco:9x6:38mm:28mm")


def corners_of(found: Corners | str) -> Corners:
    assert isinstance(found, Corners), found
    return found


def off_px(found: Corners, board: Board, T: np.ndarray) -> float:
    """RMS off the drawn corners; OpenCV may number a checkerboard from its other end."""
    truth, _ = CAMERA.project(se3.apply(T, board.points_m))
    ways = [found] if board.is_charuco else [found, found.turned(board.count)]
    return min(float(np.sqrt(((way.px - truth[way.ids]) ** 2).sum(axis=1).mean())) for way in ways)


@pytest.mark.parametrize("board", [CHECKERS, CHARUCO], ids=str)
@pytest.mark.parametrize(("z", "tilt_deg"), [(0.6, (0, 0)), (0.5, (25, -20)), (0.55, (-20, 30))])
def test_corners_are_found_where_they_were_drawn(board, z, tilt_deg) -> None:
    T = pose(board, z, tilt_deg, (0.05, -0.02))
    found = corners_of(find_corners(seen_board(board, CAMERA, T), board))
    assert len(found.ids) >= 0.9 * board.count
    assert off_px(found, board, T) < 0.25


def test_small_boards_are_found_in_an_enlarged_image() -> None:
    T = pose(CHECKERS, 2.6, (10, 15))
    found = corners_of(find_corners(seen_board(CHECKERS, CAMERA, T, blur_px=0.4), CHECKERS))
    assert off_px(found, CHECKERS, T) < 0.3


def test_half_a_charuco_board_will_do_and_half_a_checkerboard_will_not() -> None:
    aside = (0.36, 0.0)
    half = corners_of(find_corners(seen_board(CHARUCO, CAMERA, pose(CHARUCO, 0.6, at_m=aside)), CHARUCO))
    assert FEWEST_CORNERS <= len(half.ids) < CHARUCO.count
    no = find_corners(seen_board(CHECKERS, CAMERA, pose(CHECKERS, 0.6, at_m=aside)), CHECKERS)
    assert no == "no whole board is seen"


def test_a_blurred_board_is_reported_from_a_sharp_one() -> None:
    T = pose(CHECKERS, 0.6)
    truth, _ = CAMERA.project(se3.apply(T, CHECKERS.points_m))
    corners = Corners(np.arange(CHECKERS.count), truth)
    widths = [edge_width_px(seen_board(CHECKERS, CAMERA, T, blur_px=b), corners, CHECKERS) for b in (0.7, 2.0, 4.0)]
    # 0.8 of the contrast over a Gaussian edge's slope is 2.0 σ; pixels blur by 0.65 px beside it.
    np.testing.assert_allclose(widths, [2.0 * np.hypot(b, 0.65) for b in (0.7, 2.0, 4.0)], rtol=0.15)
    blurred = find_corners(seen_board(CHECKERS, CAMERA, T, blur_px=4.0), CHECKERS)
    assert isinstance(blurred, str)


def test_infrared_of_16_bits_is_stretched() -> None:
    image = np.linspace(100, 3000, 64 * 64).reshape(64, 64).astype(np.uint16)
    grey = as_grey(image)
    assert grey.dtype == np.uint8
    assert (int(grey.min()), int(grey.max())) == (0, 255)


def write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def test_views_are_paired_by_their_names(tmp_path: Path) -> None:
    image = np.zeros((8, 8), np.uint8)
    for name in ("0001-c1.jpg", "0001-d.pgm", "a_color.png", "a_ir.png", "color_7.png", "notes.png"):
        write(tmp_path / "flat" / name, image)
    for name in ("color/3.png", "depth/3.png", "ir/3.png"):
        write(tmp_path / "tree" / name, image)
    flat = {name: set(files) for name, files in find_view_files([tmp_path / "flat"]).items()}
    assert flat == {"0001": {"color", "depth"}, "a": {"color", "infrared"}, "7": {"color"}}
    assert {name: set(files) for name, files in find_view_files([tmp_path / "tree"]).items()} == {
        "3": {"color", "depth", "infrared"}
    }
    both = find_view_files([tmp_path / "flat", tmp_path / "tree"])
    assert set(both) == {"flat/0001", "flat/a", "flat/7", "tree/3"}


def test_each_image_that_cannot_be_used_has_its_reason(tmp_path: Path) -> None:
    good = seen_board(CHECKERS, CAMERA, pose(CHECKERS, 0.7))
    depth = np.full((480, 640), 700, np.uint16)
    for number in range(3):
        write(tmp_path / f"good{number}-color.png", good)
        write(tmp_path / f"good{number}-depth.png", depth)
    write(tmp_path / "half-color.png", np.roll(good, 330, axis=1) * (np.arange(640) > 330).astype(np.uint8))
    write(
        tmp_path / "size-color.png",
        seen_board(CHECKERS, PinholeCamera(800, 600, 600, 600, 400, 300), pose(CHECKERS, 0.7)),
    )
    write(tmp_path / "lone-depth.png", depth)
    write(tmp_path / "bytes-color.png", good)
    write(tmp_path / "bytes-depth.png", depth.astype(np.uint8))
    large = b"BM" + bytes(12) + struct.pack("<Iiihh", 40, 30_000, 30_000, 1, 24) + bytes(40)
    (tmp_path / "large-color.bmp").write_bytes(large)
    (tmp_path / "corrupt-color.png").write_bytes((tmp_path / "good0-color.png").read_bytes()[:200])
    seen = read_views([tmp_path], CHECKERS)
    assert [view.name for view in seen.views] == ["good0", "good1", "good2"]
    reasons = dict(seen.left_out)
    assert reasons["half"] == "no whole board is seen"
    assert reasons["size"] == "colour image is 800×600, others 640×480"
    assert reasons["lone"] == "has no colour image"
    assert "no 16-bit image" in reasons["bytes"]
    assert reasons["corrupt"] == "corrupt-color.png: is damaged, or no image"
    assert reasons["large"] == "large-color.bmp: says it is 30000×30000 pixels"
    assert not seen.is_disparity
    reading = seen.views[0].reading
    assert reading is not None
    np.testing.assert_allclose(reading, 0.7)


def test_a_board_of_another_size_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a-color.png", seen_board(CHECKERS, CAMERA, pose(CHECKERS, 0.7)))
    with pytest.raises(RecordingError, match="--board 9x6:SIDE"):
        read_views([tmp_path], board_from("8x5:35mm"))


@pytest.mark.parametrize("name", ["missing", "empty"])
def test_folders_without_images_are_refused_with_how_to_name_them(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="VIEW-color"):
        read_views([tmp_path / name], CHECKERS)


def test_raw_disparities_are_recognised(tmp_path: Path) -> None:
    write(tmp_path / "a-color.png", seen_board(CHECKERS, CAMERA, pose(CHECKERS, 0.7)))
    raw = np.full((480, 640), 650, np.uint16)
    raw[:, :9] = 2047
    write(tmp_path / "a-depth.png", raw)
    seen = read_views([tmp_path], CHECKERS)
    reading = seen.views[0].reading
    assert seen.is_disparity
    assert reading is not None
    assert (reading[0, 0], reading[0, 100]) == (0, 650)
