"""Maps that a session can drive in: those of before by name, and names that stay with them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from sessions.kept_views import write_map

from wheelsight.app.page import NEW, DriveMaps
from wheelsight.app.page.maps import KnownPlaces, NewPlaces
from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.mapping import CellKind, EditKind, MapEdit, MapEdits, OccupancyGrid
from wheelsight.slam.maps import MapFolder

CONFIG = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
HERE = np.array([0.5, 0.1, 1.0])


def maps(known: Path | None, out: Path | None) -> DriveMaps:
    return DriveMaps(CONFIG, known, None, out, in_step=True)


def test_maps_are_reported_by_their_folders_the_newest_first(tmp_path: Path) -> None:
    for name in ("2026-11-24 09.00.00", "2026-11-25 09.00.00"):
        (tmp_path / "out" / name).mkdir(parents=True)
        write_map(tmp_path / "out" / name / "map", 3)
    (tmp_path / "out" / "notes").mkdir()
    write_map(tmp_path / "home", 3)
    found = maps(tmp_path / "home", tmp_path / "out")
    assert found.first == "home"
    assert found.names() == ("home", "2026-11-25 09.00.00", "2026-11-24 09.00.00", NEW)
    assert maps(tmp_path / "home", None).names() == ("home",)
    assert maps(None, tmp_path / "nothing yet").names() == (NEW,)
    assert maps(None, tmp_path / "nothing yet").first == NEW


def test_without_a_map_and_a_folder_there_is_nothing_to_drive_in(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no map to drive in"):
        maps(None, None)
    with pytest.raises(MapError, match="no such folder"):
        maps(tmp_path / "nowhere", None)


def test_a_name_is_in_the_map_at_once(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 3)
    places = KnownPlaces(tmp_path / "map")
    assert places.where() == {}
    places.name("desk", HERE)
    np.testing.assert_allclose(places.where()["desk"], HERE)
    np.testing.assert_allclose(KnownPlaces(tmp_path / "map").where()["desk"], HERE)
    folder = MapFolder.open(tmp_path / "map")
    assert folder.named_poses().named("desk").keyframe is not None
    folder.close()
    with pytest.raises(MapError, match="is no name for a place"):
        places.name("a, b", HERE)


def test_areas_of_a_map_are_places_where_they_have_most_room(tmp_path: Path) -> None:
    """A name goes before an area; one without free floor is none."""
    write_map(tmp_path / "map", 3)
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]])
    drawn = {"kitchen": square, "desk": square, "garden": square + 50.0}
    with closing(MapFolder.open(tmp_path / "map", read_only=False)) as folder:
        folder.save_edits(MapEdits(tuple(MapEdit(EditKind.AREA, at, name=name) for name, at in drawn.items())))
    free = np.full((60, 60), CellKind.FREE, np.uint8)
    grid = OccupancyGrid.of_kinds(free, np.ones_like(free, bool), 0.05, (0.0, 0.0))
    places = KnownPlaces(tmp_path / "map", grid)
    places.name("desk", HERE)
    where = places.where()
    assert set(where) == {"kitchen", "desk"}
    np.testing.assert_allclose(where["kitchen"], (1.0, 1.0, np.nan), atol=0.05)
    np.testing.assert_allclose(where["desk"], HERE)


def test_names_of_a_map_that_is_made_move_with_its_keyframes(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 3)
    folder = MapFolder.open(tmp_path / "map")
    store = KeyframeStore()
    for number in folder.store:
        store.add(folder.store[number], folder.store.pose(number))
    places = NewPlaces(store)
    places.name("desk", HERE)
    moved = store.T_map_keyframe.copy()
    moved[:, 0, 3] += 2.0
    store.move(list(store), moved)
    np.testing.assert_allclose(places.where()["desk"], HERE + [2.0, 0, 0], atol=1e-9)
    store.close()
    folder.close()
