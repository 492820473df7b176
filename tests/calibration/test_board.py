"""Boards: what names one, and that a printed one is found again in true size."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from wheelsight.core.errors import ConfigError
from wheelsight_calibration.board import Board, Drawing, as_pdf, as_svg, board_from, draw_board

PX_PER_MM = 6


def raster(sheet: Drawing) -> np.ndarray:
    image = np.full((round(PX_PER_MM * sheet.height_mm), round(PX_PER_MM * sheet.width_mm)), 255, np.uint8)
    for x, y, w, h in sheet.rectangles:
        a, b = round(PX_PER_MM * x), round(PX_PER_MM * y)
        image[b : round(PX_PER_MM * (y + h)), a : round(PX_PER_MM * (x + w))] = 0
    return image


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("9x6:25mm", Board(9, 6, 0.025)),
        ("9 x 6 : 2.5 cm", Board(9, 6, 0.025)),
        ("7×4:?", Board(7, 4, 1.0, is_size_known=False)),
        ("charuco:9x6:30mm", Board(8, 5, 0.03, 0.022, "5X5_50")),
        ("charuco:12x9:20mm:15mm:DICT_4X4_100", Board(11, 8, 0.02, 0.015, "4X4_100")),
    ],
)
def test_a_board_is_named(text: str, board: Board) -> None:
    assert board_from(text) == board
    assert board_from(str(board)) == board


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("9x6", "names no board"),
        ("9:25mm", "no counts such as 9x6"),
        ("9x6:25", "no length with its unit"),
        ("9x6:25km", "no length with its unit"),
        ("9x6:3m", "no side of a square"),
        ("2x6:25mm", "3 to 60 each way"),
        ("charuco:9x6:20mm:25mm", "smaller than its square"),
        ("charuco:9x6:20mm:15mm:9X9_1", "no dictionary 9X9_1"),
        ("charuco:20x20:20mm:15mm:4X4_50", "take 5X5_250"),
        ("9x6:25mm:18mm", "names no board"),
    ],
)
def test_what_names_none_is_refused_with_what_would(text: str, reported: str) -> None:
    with pytest.raises(ConfigError, match=r"\(.+\)") as refusal:
        board_from(text)
    assert reported in str(refusal.value)


def test_half_turns() -> None:
    assert board_from("9x6:25mm").is_half_turn_seen
    assert not board_from("8x6:25mm").is_half_turn_seen
    assert board_from("charuco:9x7:25mm").is_half_turn_seen


def test_a_printed_checkerboard_is_found_with_corners_where_they_were_drawn() -> None:
    board = board_from("9x6:25mm")
    found, corners = cv2.findChessboardCornersSB(raster(draw_board(board)), (9, 6))
    assert found
    corners_mm = corners.reshape(-1, 2) / PX_PER_MM
    steps_mm = np.diff(corners_mm.reshape(6, 9, 2), axis=1)
    np.testing.assert_allclose(np.abs(steps_mm[..., 0]), 25, atol=0.05)


def test_a_printed_charuco_board_is_found_and_its_corners_are_numbered_as_points_are() -> None:
    board = board_from("charuco:9x6:27mm")
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board.charuco()).detectBoard(raster(draw_board(board)))
    assert sorted(ids.ravel()) == list(range(board.count))
    drawn_mm = corners.reshape(-1, 2)[np.argsort(ids.ravel())] / PX_PER_MM
    points_mm = 1e3 * board.points_m[:, :2]
    np.testing.assert_allclose(drawn_mm - drawn_mm[0], points_mm - points_mm[0], atol=0.2)


def test_files_tell_true_sizes_and_the_board() -> None:
    sheet = draw_board(board_from("9x6:25mm"), "letter")
    svg, pdf = as_svg(sheet), as_pdf(sheet).decode("latin-1")
    assert 'width="279.4mm" height="215.9mm"' in svg
    assert "--board 9x6:25mm" in svg
    assert "--board 9x6:25mm" in pdf
    assert re.search(r"/MediaBox \[0 0 792\.0000 612\.0000\]", pdf)
    start = int(re.findall(r"startxref\n(\d+)", pdf)[0])
    assert pdf[start:].startswith("xref")
    for number, offset in enumerate(re.findall(r"^(\d{10}) 00000 n", pdf, re.MULTILINE), start=1):
        assert pdf[int(offset) :].startswith(f"{number} 0 obj")


@pytest.mark.parametrize(
    ("board", "paper", "reported"),
    [("20x15:25mm", "A4", "squares of at most 11 mm"), ("9x6:?", "A4", "unknown size"), ("9x6:25mm", "B5", "A4")],
)
def test_what_cannot_be_printed_is_refused(board: str, paper: str, reported: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        draw_board(board_from(board), paper)
    assert reported in str(refusal.value)
