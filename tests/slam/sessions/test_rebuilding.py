"""A map made again: of a wall that two keyframes see, each from its own place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sessions.kept_views import CALIBRATION, INTRINSICS, SETTINGS, edge, write_map

from wheelsight.core.errors import MapError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.core.settings import RecognitionSettings
from wheelsight.slam.maps import MapFolder, fuse_keyframes, rebuild

RECOGNITION = RecognitionSettings()
WALL_M = 2.0


def moved(x_m: float) -> np.ndarray:
    return se3.exp([x_m, 0, 0, 0, 0, 0])


def wall(stamp_s: float) -> Keyframe:
    """Seen head on, whatever the way along it."""
    grey = np.random.default_rng(1).integers(1, 256, (48, 64)).astype(np.float32)
    return Keyframe.of_images(stamp_s, INTRINSICS, np.full((48, 64), WALL_M, np.float32), grey)


@pytest.fixture
def walled(tmp_path: Path) -> Path:
    """Three keyframes; the second was moved since, and lies 20 s later than the first."""
    folder = MapFolder.create(tmp_path / "map", CALIBRATION, SETTINGS, source="a wall")
    for number, (stamp_s, x_m) in enumerate(((1.0, 0.0), (21.0, 0.4), (22.0, 5.0))):
        folder.append_keyframe(number, wall(stamp_s), moved(x_m), moved(x_m))
    folder.append_edges([edge(0, 1), edge(1, 2), edge(2, 0, is_loop=True)])
    folder.withdraw_edges([2])
    folder.append_poses([1], moved(0.2)[None])
    folder.close()
    return tmp_path / "map"


def test_surfels_lie_where_keyframes_are_by_now(walled: Path) -> None:
    done: list[tuple[int, int]] = []
    surfel_map = fuse_keyframes(MapFolder.open(walled), on_keyframe=lambda k, of: done.append((k, of)))
    assert done == [(1, 3), (2, 3), (3, 3)]
    surfels, stable = surfel_map.surfels(), surfel_map.surfels("stable")
    assert_allclose(surfels.position[:, 2], WALL_M, atol=0.004)
    # What two keyframes see is sure; the third has its part of the wall for itself.
    reach_m = WALL_M * 31 / 60
    assert len(stable.grey) > 100
    assert stable.position[:, 0].min() > 0.2 - reach_m - 0.05
    assert stable.position[:, 0].max() < reach_m + 0.05
    assert set(surfels.keyframe.tolist()) == {0, 1, 2}
    assert surfels.position[surfels.keyframe == 2][:, 0].min() > 5 - reach_m - 0.05
    assert surfels.position[surfels.keyframe == 0][:, 0].min() < -0.9 * reach_m


def test_a_rebuilt_map_is_whole_and_leaves_out_what_is_outdated(walled: Path, tmp_path: Path) -> None:
    doings: list[str] = []
    old = MapFolder.open(walled)
    new = rebuild(old, tmp_path / "new", None, RECOGNITION, lambda doing, *_: doings.append(doing))
    assert list(dict.fromkeys(doings)) == ["fusing", "writing", "recognition"]
    assert new.path == tmp_path / "new"
    assert_array_equal(new.store.T_map_keyframe, [moved(0.0), moved(0.2), moved(5.0)])
    assert [(one.first, one.second) for one in new.edges] == [(0, 1), (1, 2)]
    assert new.contents.edge_count == 2
    assert_array_equal(new.contents.places[1].T_odom_keyframe, moved(0.4))
    for number in (0, 1, 2):
        assert_array_equal(new.store[KeyframeId(number)].depth_m, old.store[KeyframeId(number)].depth_m)
    assert new.header.source == "a wall"
    surfels = new.surfels()
    assert surfels is not None
    assert len(surfels) == len(fuse_keyframes(old))
    made: list[int] = []
    assert len(new.recognizer(RECOGNITION, lambda k, of: made.append(k))) == 3
    assert made == []
    assert len(MapFolder.open(walled).store) == 3  # which stays as it is


def test_a_map_without_keyframes_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 0)
    with pytest.raises(MapError, match="has no keyframes"):
        rebuild(MapFolder.open(tmp_path / "map"), tmp_path / "new")
    assert not (tmp_path / "new").exists()
