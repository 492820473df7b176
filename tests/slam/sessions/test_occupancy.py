"""The occupancy map of a map folder: written when it is finished, made again with it, and edits that outlast both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mapping.floor_scenes import ROBOT
from numpy.testing import assert_array_equal
from sessions.kept_views import write_map
from sessions.mounted_maps import WAY, drive, view
from sessions.seen_maps import RING, aside, step, write_seen

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.settings import RecognitionSettings
from wheelsight.io.ros_map import FREE, OCCUPIED, read_ros_map
from wheelsight.mapping import CellKind, EditKind, MapEdit, MapEdits, OccupancyMapper, OccupancySettings
from wheelsight.slam.maps import (
    MapFolder,
    MapWriter,
    SessionSettings,
    discard_map,
    driven_way,
    info_of,
    merge,
    occupancy_of,
    prune,
    rebuild,
)
from wheelsight.slam.maps.journal import read_journal

RECOGNITION = RecognitionSettings()
FILES = {"occupancy.pgm", "occupancy.yaml"}
CORNER = np.array([[1.6, 0.6], [2.4, 0.6], [2.4, 1.4], [1.6, 1.4]])


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    drive(tmp_path / "map", WAY).close()
    return tmp_path / "map"


def zone_at(polygon: FloatArray, number: int, T_map_keyframe: FloatArray) -> MapEdit:
    return MapEdit(EditKind.KEEP_OUT, polygon).anchored(KeyframeId(number), T_map_keyframe[number])


def test_a_drive_leaves_its_occupancy_map_when_it_is_finished(tmp_path: Path) -> None:
    writer = drive(tmp_path / "map", WAY)
    assert not FILES & {path.name for path in (tmp_path / "map").iterdir()}
    writer.close()
    assert writer.warnings == ()
    folder = MapFolder.open(tmp_path / "map")
    plan, grid = read_ros_map(folder.path / "occupancy.yaml"), occupancy_of(folder)
    # On disk depth is kept in steps of its noise, and fewer pixels.
    assert plan.origin == pytest.approx((*grid.origin, 0.0), abs=0.11)
    middles = grid.middle_of(np.argwhere(grid.occupancy == FREE))
    column, row = np.floor(plan.to_cells(middles)).astype(int).T
    assert (plan.occupancy[row, column] == FREE).mean() > 0.98
    at_once = OccupancyMapper(ROBOT)
    for number, T in enumerate(WAY):
        at_once.add(KeyframeId(number), view(T, float(number)), T)
    assert_array_equal(plan.occupancy, at_once.grid().occupancy)
    reported = info_of(folder)
    assert reported.occupancy_bytes == sum((folder.path / name).stat().st_size for name in FILES)
    assert reported.edits == 0
    inner, outer = driven_way(folder)
    assert len(inner) == len(outer) == len(WAY) / 2
    np.testing.assert_allclose([inner[0, :2], outer[0, :2]], [[0.3, 0.0], [-0.9, 0.0]], atol=1e-9)
    discard_map(folder.path)
    assert not folder.path.exists()


def test_where_the_camera_sits_nowhere_there_is_none(tmp_path: Path) -> None:
    write_map(tmp_path / "map", 3)
    new = rebuild(MapFolder.open(tmp_path / "map"), tmp_path / "new", None, RECOGNITION)
    assert not FILES & {path.name for path in new.path.iterdir()}
    assert info_of(new).occupancy_bytes is None


def test_a_map_too_large_is_whole_without_it_and_says_so(tmp_path: Path) -> None:
    settings = SessionSettings(occupancy=OccupancySettings(most_cells=10_000))
    writer = drive(tmp_path / "map", WAY, settings)
    writer.close()
    (warning,) = writer.warnings
    assert warning.startswith("The occupancy map was not written: the occupancy map would be ")
    assert len(MapFolder.open(tmp_path / "map").store) == len(WAY)


def test_edits_outlast_a_rebuild_and_move_with_their_keyframe(kept: Path, tmp_path: Path) -> None:
    folder = MapFolder.open(kept, read_only=False)
    T_new_old = se3.from_plane(0.5, 1.0, np.pi / 2)
    fixed = MapEdit(EditKind.KEEP_OUT, CORNER - [2.5, 2.0])
    folder.save_edits(MapEdits((zone_at(CORNER, 2, folder.store.T_map_keyframe), fixed)))
    folder.append_poses(list(range(len(WAY))), T_new_old @ np.array(WAY))
    folder.close()
    new = rebuild(MapFolder.open(kept), tmp_path / "new", None, RECOGNITION)
    assert len(new.map_edits()) == info_of(new).edits == 2
    grid, plan = occupancy_of(new), read_ros_map(new.path / "occupancy.yaml")
    assert_array_equal(plan.occupancy, grid.occupancy)
    middle = CORNER.mean(axis=0)
    assert grid.kind_at(se3.apply(T_new_old, [[*middle, 0.0]])[:, :2]) == CellKind.KEEP_OUT
    assert grid.kind_at(fixed.polygon.mean(axis=0)) == CellKind.KEEP_OUT
    row, column = grid.cells_at(se3.apply(T_new_old, [[*middle, 0.0]])[0, :2])
    assert plan.occupancy[row, column] == OCCUPIED
    # The room's own walls are where its keyframes are by now: it is 4 m wide in x.
    walls = grid.middle_of(np.argwhere(grid.kind == CellKind.OBSTACLE))
    assert walls[:, 0].min() == pytest.approx(0.5 - 2.0, abs=0.1)
    assert walls[:, 0].max() == pytest.approx(0.5 + 2.0, abs=0.1)


def test_what_is_wiped_is_free_in_the_file(kept: Path, tmp_path: Path) -> None:
    folder = MapFolder.open(kept, read_only=False)
    wall = np.array([[2.9, -0.5], [3.1, -0.5], [3.1, 0.5], [2.9, 0.5]])
    folder.save_edits(MapEdits((MapEdit(EditKind.WIPED, wall),)))
    folder.close()
    before = read_ros_map(kept / "occupancy.yaml")
    after = read_ros_map(rebuild(MapFolder.open(kept), tmp_path / "new", None, RECOGNITION).path / "occupancy.yaml")
    column, row = np.floor(before.to_cells(np.array([3.0 + 0.01, 0.0]))).astype(int)
    assert OCCUPIED in before.occupancy[row, column - 2 : column + 2]
    column, row = np.floor(after.to_cells(np.array([3.0 + 0.01, 0.0]))).astype(int)
    assert OCCUPIED not in after.occupancy[row, column - 2 : column + 2]
    assert FREE in after.occupancy[row, column - 2 : column + 2]


def test_a_zone_whose_keyframe_is_lost_stays_where_it_was_drawn(kept: Path) -> None:
    folder = MapFolder.open(kept, read_only=False)
    folder.save_edits(MapEdits((zone_at(CORNER, 1, folder.store.T_map_keyframe),)))
    folder.close()
    path = kept / "keyframes-00000.journal"
    data = bytearray(path.read_bytes())
    data[read_journal(path).records[1][0].offset + 99] ^= 1
    path.write_bytes(data)
    damaged = MapFolder.open(kept)
    assert [int(number) for number in damaged.store.missing] == [1]
    assert occupancy_of(damaged).kind_at(CORNER.mean(axis=0)) == CellKind.KEEP_OUT


def test_what_lies_nowhere_for_sure_is_not_in_it(tmp_path: Path) -> None:
    """Two views of a drive that was cut in two: no one knows how they lie to the others."""
    way = [*WAY[:4], *(se3.from_plane(20.0, 0.0, 0.0) @ T for T in WAY[4:6])]
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", ROBOT), store)
    for number, T in enumerate(way):
        store.add(view(WAY[number], float(number)), T)
        writer.update(None)
    writer.add_edges([step(way, number) for number in (0, 1, 2, 4)])
    writer.close()
    grid = occupancy_of(MapFolder.open(tmp_path / "map"))
    assert grid.kind.shape[1] * grid.resolution_m < 8.0


def test_the_way_is_cut_where_no_one_knows_how_the_robot_drove(tmp_path: Path) -> None:
    """A long step, and a second drive that a loop joins to the first."""
    east = se3.from_plane(2.0, 0.0, 0.0)
    way = [*WAY[:2], *(east @ T for T in WAY[2:6])]
    store = KeyframeStore()
    writer = MapWriter(MapFolder.create(tmp_path / "map", ROBOT), store)
    for number, T in enumerate(way):
        store.add(view(WAY[number], float(number)), T)
        writer.update(None)
    loop = replace(step(way, 3), is_loop=True)
    writer.add_edges([*(step(way, number) for number in (0, 1, 2, 4)), loop])
    writer.close()
    stretches = driven_way(MapFolder.open(tmp_path / "map"))
    assert [len(stretch) for stretch in stretches] == [2, 2, 2]
    T_map_base = np.array(way) @ np.linalg.inv(np.asarray(ROBOT.T_base_camera))
    found = np.concatenate(stretches)
    np.testing.assert_allclose(found[:, :2], T_map_base[:, :2, 3], atol=1e-9)
    np.testing.assert_allclose(found[:, 2], np.arctan2(T_map_base[:, 1, 0], T_map_base[:, 0, 0]), atol=1e-9)


def test_a_map_without_keyframes_has_no_way(tmp_path: Path) -> None:
    MapFolder.create(tmp_path / "map", ROBOT).close()
    assert driven_way(MapFolder.open(tmp_path / "map")) == ()


@pytest.mark.parametrize("count", [1, 2])
def test_the_way_of_a_map_of_few_keyframes_is_one_stretch(tmp_path: Path, count: int) -> None:
    """One keyframe is what a map has that was saved before the robot moved."""
    drive(tmp_path / "map", WAY[:count]).close()
    (stretch,) = driven_way(MapFolder.open(tmp_path / "map"))
    T_map_base = np.array(WAY[:count]) @ np.linalg.inv(np.asarray(ROBOT.T_base_camera))
    np.testing.assert_allclose(stretch[:, :2], T_map_base[:, :2, 3], atol=1e-9)


def test_pruning_and_merging_carry_edits(tmp_path: Path) -> None:
    T_monday = write_seen(tmp_path / "monday", RING[:4])
    T_tuesday = write_seen(
        tmp_path / "tuesday", [aside(T, 0.03) for T in RING[:5]], se3.from_plane(3, 1, 0.5), begin_s=100.0
    )
    days = [MapFolder.open(tmp_path / name, read_only=False) for name in ("monday", "tuesday")]
    days[0].save_edits(MapEdits((zone_at(CORNER, 1, np.array(T_monday)),)))
    days[1].save_edits(MapEdits((MapEdit(EditKind.WIPED, CORNER),)))
    for day in days:
        day.close()
    made = merge(days[0], days[1], tmp_path / "both", recognition=RECOGNITION).folder
    zone, wiped = made.map_edits().edits
    assert (zone.kind, zone.keyframe, wiped.kind) == (EditKind.KEEP_OUT, 1, EditKind.WIPED)
    assert wiped.keyframe is not None
    assert wiped.keyframe >= len(T_monday)
    # Where tuesday's map lies in monday's frame.
    number = int(wiped.keyframe) - len(T_monday)
    T_first_second = made.store.pose(wiped.keyframe) @ se3.invert(T_tuesday[number])
    there = se3.apply(T_first_second, np.c_[CORNER, np.zeros(4)])[:, :2]
    np.testing.assert_allclose(wiped.polygon_now(made.store.T_map_keyframe), there, atol=1e-9)
    np.testing.assert_allclose(
        there, se3.apply(se3.invert(se3.from_plane(3, 1, 0.5)), np.c_[CORNER, np.zeros(4)])[:, :2], atol=0.1
    )
    left = prune(made, tmp_path / "pruned", RECOGNITION).folder
    assert len(left.store) < len(made.store)
    for before, after in zip(made.map_edits().edits, left.map_edits().edits, strict=True):
        now = after.polygon_now(left.store.T_map_keyframe)
        np.testing.assert_allclose(now, before.polygon_now(made.store.T_map_keyframe), atol=1e-9)


def test_extending_a_map_makes_it_of_all_its_keyframes(kept: Path) -> None:
    folder = MapFolder.open(kept, read_only=False)
    writer = MapWriter(folder, folder.store)
    T = se3.from_plane(20.0, 0.0, 0.0) @ WAY[0]
    folder.store.add(view(WAY[0], 100.0), T)
    writer.update(None)
    writer.add_edges([step([*WAY, T], len(WAY) - 1)])
    writer.close()
    assert writer.warnings == ()
    plan = read_ros_map(kept / "occupancy.yaml")
    walls_m = plan.to_map(np.argwhere(plan.occupancy == OCCUPIED)[:, ::-1] + 0.5)[:, 0]
    assert (walls_m.min(), walls_m.max()) == pytest.approx((-3.0, 23.0), abs=0.06)


def test_a_map_too_large_is_rebuilt_all_the_same(tmp_path: Path) -> None:
    few = SessionSettings(occupancy=OccupancySettings(most_cells=10_000))
    drive(tmp_path / "map", WAY, few).close()
    new = rebuild(MapFolder.open(tmp_path / "map", settings=few), tmp_path / "new", None, RECOGNITION)
    assert (len(new.store), info_of(new).occupancy_bytes) == (len(WAY), None)
