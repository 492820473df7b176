"""Which keyframes of a map hang together by edges that are sure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_array_equal
from sessions.kept_views import CALIBRATION, SETTINGS, edge, keyframe, pose

from wheelsight.slam.maps import MapFolder, in_largest_piece


def written(path: Path, ends: list[tuple[int, int]], count: int, sigma: float = 0.01) -> MapFolder:
    folder = MapFolder.create(path, CALIBRATION, SETTINGS)
    for number in range(count):
        folder.append_keyframe(number, keyframe(number), pose(number))
    folder.append_edges([replace(edge(*pair), covariance=sigma**2 * np.eye(6)) for pair in ends])
    folder.close()
    return MapFolder.open(path)


def test_the_largest_piece_counts_wherever_it_begins(tmp_path: Path) -> None:
    found = written(tmp_path / "map", [(0, 1), (2, 3), (4, 3)], 5)
    assert_array_equal(in_largest_piece(found), [False, False, True, True, True])


def test_an_edge_that_shows_nothing_holds_nothing_together(tmp_path: Path) -> None:
    assert in_largest_piece(written(tmp_path / "vague", [(0, 1), (1, 2)], 3, sigma=0.4)).sum() == 1
    assert in_largest_piece(written(tmp_path / "sure", [(0, 1), (1, 2)], 3, sigma=0.2)).all()


def test_in_a_map_without_keyframes_nothing_lies_together(tmp_path: Path) -> None:
    assert len(in_largest_piece(written(tmp_path / "map", [], 0))) == 0
