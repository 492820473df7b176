from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sessions.kept_views import CALIBRATION, edge, keyframe, pose, write_map

from wheelsight.core.errors import MapError
from wheelsight.slam.maps import MapFolder, find_map, info_of


def test_figures_of_a_map(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 6)
    folder = MapFolder.open(tmp_path / "map", read_only=False)
    folder.append_edges([edge(5, 0, is_loop=True)])
    folder.append_keyframe(6, keyframe(6), pose(6))
    folder.append_keyframe(7, keyframe(7), pose(7))
    folder.append_edges([edge(6, 7)])
    folder.close()
    found = info_of(MapFolder.open(tmp_path / "map"))
    assert (found.keyframes, found.edges, found.loops, found.parts) == (8, 6, 1, 2)
    assert (found.begin_s, found.end_s) == (0.0, 7.0)
    at = np.array([pose(k)[:3, 3] for k in range(8)])
    assert found.length_m == pytest.approx(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())
    files = [path.stat().st_size for path in (tmp_path / "map").iterdir()]
    journals = [path.stat().st_size for path in (tmp_path / "map").glob("*.journal")]
    assert (found.bytes, found.keyframe_bytes) == (sum(files), sum(journals) / 8)
    assert (found.surfel_bytes, found.recognition_bytes) == (None, None)
    reported = json.loads(json.dumps(found.to_dict()))
    assert reported["camera"]["fx"] == 60.0
    assert reported["health"] == {"is_whole": True, "notes": []}
    assert reported["keyframes"] == 8


def test_an_empty_map_has_figures(tmp_path: Path) -> None:
    MapFolder.create(tmp_path / "map", CALIBRATION).close()
    found = info_of(MapFolder.open(tmp_path / "map"))
    assert (found.keyframes, found.parts, found.begin_s, found.length_m) == (0, 0, None, 0.0)


@pytest.mark.parametrize("place", [".", "map", "joined/map", "dense/map"])
def test_a_map_is_found_in_the_folder_of_its_run(tmp_path: Path, place: str) -> None:
    (tmp_path / "run").mkdir()
    write_map(tmp_path / "run" / place, 1)
    assert find_map(str(tmp_path / "run")) == tmp_path / "run" / place


def test_what_is_no_map_is_reported(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="is no map, and no folder of a run with one"):
        find_map(tmp_path)
    with pytest.raises(MapError, match="there is no such folder"):
        find_map(tmp_path / "nowhere")
