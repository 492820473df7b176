"""Doors that swing: where their leaves are, when, and that no one is in their way."""

from __future__ import annotations

import filecmp
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
from floor_plans import two_rooms, write_plan
from grids import mostly_slow
from small_rooms import looking, room

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, PinholeCamera
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import SimulationSettings, simulate, write_simulation
from wheelsight_sim.doors import Doors, DoorSettings
from wheelsight_sim.people import RADIUS_M, Passersby
from wheelsight_sim.robot import Drive
from wheelsight_sim.scene import Scene
from wheelsight_sim.simulated_recording import SimulatedRecording
from wheelsight_sim.world import Leaf, World
from wheelsight_sim.worlds import FloorPlan

CAMERA = PinholeCamera(64, 48, 60, 60, 31.5, 23.5)
HALF_M = 0.0225  # of a leaf's thickness
TURN_RAD = math.radians(90.0)
# Shut, it fills a gap of 1 m in a plane 3 m ahead of a camera at the origin; hinged on the camera's left.
LEAF = '<geom name="leaf" type="box" pos="3 0 1" size="0.0225 0.5 1"/>'
BEHIND = '<geom name="end" type="box" pos="9 0 1.5" size="0.1 5 1.5"/>'


def gap() -> World:
    return replace(room(LEAF + BEHIND), leaves=(Leaf("leaf", (3.0, 0.5), TURN_RAD),))


def standing(seconds: float, in_gap_s: tuple[float, float] = (0.0, 0.0)) -> Drive:
    """A robot that stands 10 m away from the gap, but in it between two times."""
    stamps_s = np.arange(0, seconds, 0.01)
    T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    T[:, 0, 3] = np.where((stamps_s >= in_gap_s[0]) & (stamps_s < in_gap_s[1]), 3.0, -7.0)
    return Drive(Trajectory(stamps_s, T, body="base"), ())


def depth_of_plane(point: FloatArray, normal: FloatArray) -> FloatArray:
    """Along z of a camera at (0, 0, 1) that looks along x."""
    T = looking()
    return np.asarray((point - T[:3, 3]) @ normal / (CAMERA.rays() @ T[:3, :3].T @ normal))


def test_a_leaf_is_seen_where_its_angle_has_it() -> None:
    doors = Doors(gap(), standing(60.0), 1, seed=3)
    scene = Scene(gap(), threads=1, doors=doors)
    swing = doors.swings[0][0]
    start = doors.starts[0]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        stamp_s = swing.begin_s + share * (swing.end_s - swing.begin_s)
        moved = share**3 * (10 - 15 * share + 6 * share**2)
        turn_rad = TURN_RAD * (start + (swing.to_share - start) * moved)
        scene.move_to(stamp_s)
        view = scene.cast(CAMERA, looking())
        is_leaf = view.geom == scene.geoms.names.index("leaf")
        assert is_leaf.sum() > 20
        # The leaf leads from its hinge to the right when it is shut; its faces lie half its thickness aside.
        along = np.array([math.sin(turn_rad), -math.cos(turn_rad), 0.0])
        normal = np.array([along[1], -along[0], 0.0])
        hinge = np.array([3.0, 0.5, 1.0])
        faces = [depth_of_plane(hinge + side * HALF_M * normal, normal) for side in (-1, 1)]
        ends = [depth_of_plane(hinge + length_m * along, along) for length_m in (0.0, 1.0)]
        off_m = np.min([abs(view.depth_m - expected)[is_leaf] for expected in (*faces, *ends)], axis=0)
        assert off_m.max() < 1e-5


def test_what_is_behind_an_open_door_is_seen() -> None:
    doors = Doors(gap(), standing(60.0), 1, seed=3)
    scene = Scene(gap(), threads=1, doors=doors)
    middle = CAMERA.height // 2, CAMERA.width // 2
    depths = {0.0: 3 - HALF_M, 1.0: 8.9}
    for swing in doors.swings[0]:
        scene.move_to(swing.end_s)
        assert scene.cast(CAMERA, looking()).depth_m[middle] == pytest.approx(depths[swing.to_share], abs=1e-5)
    assert {swing.to_share for swing in doors.swings[0]} == {0.0, 1.0}


@pytest.fixture(scope="module", params=mostly_slow(["flat", "house"], quick=["flat"]))
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SimulatedRecording:
    settings = SimulationSettings("flat", size=(64, 48), seed=2, duration_s=40.0, passersby=2, doors=4)
    if request.param == "house":
        plan = FloorPlan(write_plan(tmp_path_factory.mktemp("house"), two_rooms()))
        settings = replace(settings, plan=plan, doors=1)
    return simulate(settings)


def board(middle: FloatArray, yaw_rad: float, half_m: float) -> shapely.Geometry:
    along = half_m * np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    return shapely.LineString([middle[:2] - along, middle[:2] + along]).buffer(HALF_M, cap_style="flat")


def test_no_one_meets_a_leaf(recording: SimulatedRecording) -> None:
    doors, world, settings = recording.renderer.doors, recording.world, recording.settings
    assert doors is not None
    people = Passersby(world, recording.drive, settings.passersby, settings.day_seed, settings.robot)
    scene = Scene(world, people, threads=1, doors=doors)
    half_m = [scene.geoms.size_m[scene.geoms.names.index(leaf.geom), 0] for leaf in doors.leaves]
    swung = np.zeros(len(doors.leaves), bool)
    for stamp_s in np.arange(0, recording.drive.duration_s, 0.05):
        T = recording.drive.truth.at([stamp_s])[0]
        corners = np.array([(-0.3, -0.3), (0.8, -0.3), (0.8, 0.3), (-0.3, 0.3)])
        outline = shapely.Polygon(corners @ T[:2, :2].T + T[:2, 3])
        walkers = shapely.MultiPoint(people.positions_at(stamp_s)).buffer(RADIUS_M)
        middles, yaws_rad = doors.poses_at(stamp_s)
        for middle, yaw_rad, half in zip(middles, yaws_rad, half_m, strict=True):
            leaf = board(middle, yaw_rad, half)
            # Where a leaf is at rest, the way may lead by nearer than that; nothing is ever touched.
            assert shapely.distance(leaf, outline) > 0.1
            assert shapely.distance(leaf, walkers) > 0.0
        swung |= doors.turns_at(stamp_s) != 0
    assert swung.any()


def test_swings_take_as_long_as_hands_and_come_one_after_another(recording: SimulatedRecording) -> None:
    doors, settings = recording.renderer.doors, DoorSettings()
    assert doors is not None
    for start, swings in zip(doors.starts, doors.swings, strict=True):
        assert start in (0.0, 1.0)
        for k, swing in enumerate(swings):
            assert settings.swing_s[0] <= swing.end_s - swing.begin_s <= settings.swing_s[1]
            assert swing.to_share == (1.0 - start if k % 2 == 0 else start)
        assert all(b.begin_s >= a.end_s for a, b in pairwise(swings))


def test_a_way_that_shut_leaves_would_bar_is_driven() -> None:
    """Else all the above would hold of doors that no one passes: of the flat's four, the lap passes each."""
    recording = simulate(SimulationSettings("flat", size=(64, 48), seed=2, doors=4))
    assert recording.drive.is_complete
    doors, way = recording.renderer.doors, shapely.LineString(recording.ground_truth.positions_m[::20, :2])
    assert doors is not None
    for leaf in doors.leaves:
        assert shapely.distance(way, shapely.Point(leaf.hinge_m)) < 0.8


def test_equal_seeds_make_equal_doors_and_days_differ() -> None:
    settings = SimulationSettings("flat", size=(64, 48), seed=4, duration_s=20.0, doors=3)
    one, same = (simulate(settings).renderer.doors for _ in range(2))
    other = simulate(replace(settings, day=1)).renderer.doors
    assert one is not None
    assert same is not None
    assert other is not None
    assert one.to_csv() == same.to_csv() != other.to_csv()


def test_a_drive_with_doors_is_repeated_to_the_byte(tmp_path: Path) -> None:
    settings = SimulationSettings("flat", size=(64, 48), rate_hz=2.0, seed=4, duration_s=4.0, doors=4, realism="real")
    for name in ("one", "same"):
        write_simulation(simulate(settings), tmp_path / name)
    files = sorted(str(path.relative_to(tmp_path / "one")) for path in (tmp_path / "one").rglob("*") if path.is_file())
    assert "truth/doors.csv" in files
    assert filecmp.cmpfiles(tmp_path / "one", tmp_path / "same", files, shallow=False)[1:] == ([], [])


def test_without_doors_asked_for_the_flat_is_what_it_was() -> None:
    world = simulate(SimulationSettings("flat", size=(64, 48), duration_s=1.0)).world
    assert world.leaves == ()
    assert 'name="leaf' not in world.mjcf


@pytest.mark.parametrize(("world", "doors", "room_for"), [("flat", 5, 4), ("floor4", 1, 0)])
def test_more_doors_than_there_are_is_refused(world: str, doors: int, room_for: int) -> None:
    reported = f"--doors is {doors}; in world {world} there is room for {room_for} to swing"
    with pytest.raises(ConfigError, match=reported):
        simulate(SimulationSettings(world, duration_s=1.0, doors=doors))


def test_a_leaf_that_would_swing_into_something_stays() -> None:
    blocked = room(LEAF + BEHIND + '<geom name="bin" type="cylinder" pos="3.5 0.2 0.3" size="0.2 0.3"/>')
    with pytest.raises(ConfigError, match="room for 0"):
        Doors(replace(blocked, leaves=gap().leaves), standing(10.0), 1, seed=0)


def test_a_door_is_at_rest_all_the_while_somebody_stands_in_its_way() -> None:
    drive = standing(60.0, in_gap_s=(20.0, 40.0))
    for seed in range(10):
        doors = Doors(gap(), drive, 1, seed)
        assert not any(doors.turns_at(stamp_s).any() for stamp_s in np.arange(20.0, 40.0, 0.05))
        assert any(doors.turns_at(stamp_s).any() for stamp_s in np.arange(40.0, 60.0, 0.05))
