"""Worlds of floor plans: walls where the plan has them, a way that the wheelchair can drive, and looks by seed."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
import shapely
from floor_plans import DOORWAYS_M, UNKNOWN, rooms_in_colours, two_rooms, write_plan
from grids import mostly_slow

from wheelsight.core.errors import AreaError, ConfigError, MapError
from wheelsight_sim import FloorPlan, RobotModel, SimulationSettings, World, simulate
from wheelsight_sim.clearance import find_collision, footprints
from wheelsight_sim.worlds import build_floor_plan

REAL = {
    "basement_fixed.map.yaml": None,
    "ctrl_room.yaml": None,
    "indoor.yaml": None,
    "map_real.yaml": None,
    "willow-2010-02-18-0.10.yaml": None,
    "Freiburg79_scan.png": 0.05,
    "lab_ipa.png": 0.05,
    "office_b.png": 0.05,
}


def built(path: Path, seed: int = 0, robot: RobotModel | None = None, **plan: object) -> World:
    return build_floor_plan(FloorPlan(path, **plan), seed, robot or RobotModel())  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_plan(tmp_path_factory.mktemp("plans"), two_rooms())


@pytest.fixture(scope="module")
def world(house: Path) -> World:
    return built(house)


def hits(world: World, start: tuple[float, float], angles_rad: np.ndarray) -> np.ndarray:
    """Distances at which level rays just below the ceiling end, above all furniture and doors."""
    model = mujoco.MjModel.from_xml_string(world.mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rays = np.stack([np.cos(angles_rad), np.sin(angles_rad), 0 * angles_rad], axis=-1)
    far, geom = np.zeros(len(rays)), np.zeros(len(rays), np.int32)
    mujoco.mj_multiRay(model, data, np.array([*start, 2.7]), rays.ravel(), None, 1, -1, geom, far, None, len(rays), 1e3)
    return far


def test_walls_stand_where_the_plan_has_them(world: World) -> None:
    far = hits(world, (3.0, 6.0), np.radians([0, 90, 180, 270]))
    np.testing.assert_allclose(far, [3.0, 2.0, 2.8, 3.6], atol=0.03)


@pytest.mark.slow
def test_specks_of_a_scanner_are_no_walls(tmp_path: Path, world: World, rng: np.random.Generator) -> None:
    angles = np.linspace(-math.pi, math.pi, 200)
    clean = hits(world, (3.0, 6.0), angles)
    (tmp_path / "noisy").mkdir()
    noisy = hits(built(write_plan(tmp_path / "noisy", two_rooms(rng))), (3.0, 6.0), angles)
    # Specks that touch a wall are taken for a part of it, but for its corners no more than 2 cells thick.
    assert np.mean(np.abs(noisy - clean) < 0.12) > 0.97


@pytest.mark.slow
def test_jagged_walls_are_drawn_straight(tmp_path: Path, rng: np.random.Generator) -> None:
    image = two_rooms()
    beside = (cv2.dilate((image == 0).astype(np.uint8), np.ones((3, 3))) > 0) & (image == 254)
    image[beside & (rng.random(image.shape) < 0.25)] = 0
    world = built(write_plan(tmp_path, image))
    walls = [thing.polygon.length / 2 for thing in footprints(world) if thing.name.startswith("wall_")]
    assert np.median(walls) > 0.5
    np.testing.assert_allclose(hits(world, (3.0, 6.0), np.radians([0, 90, 180])), [3.0, 2.0, 2.8], atol=0.12)


def test_nothing_but_walls_and_doors_closes_the_floor(world: World) -> None:
    """All around every waypoint a level ray ends within the house."""
    for x, y in world.route[::5]:
        far = hits(world, (x, y), np.linspace(-math.pi, math.pi, 360))
        assert far.max() < 15
        assert far.min() > 0


@pytest.mark.parametrize("yaw_rad", mostly_slow([0.5, 3.14], quick=[0.5]))
def test_a_rotated_origin_turns_the_world(tmp_path: Path, yaw_rad: float) -> None:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turned = built(write_plan(tmp_path, two_rooms(), (5.0, 3.0, yaw_rad)))
    x, y = 5 + c * 4 - s * 7, 3 + s * 4 + c * 7
    far = hits(turned, (x, y), yaw_rad + np.radians([0, 90, 180, 270]))
    np.testing.assert_allclose(far, [3.0, 2.0, 2.8, 3.6], atol=0.03)
    assert find_collision(turned, turned.route, RobotModel().width_m / 2 + 0.1) is None


@pytest.mark.parametrize("seed", mostly_slow(range(3), quick=[0, 1]))
def test_the_route_is_a_loop_that_keeps_clear_of_everything(house: Path, world: World, seed: int) -> None:
    world = built(house, seed) if seed else world
    assert world.is_loop
    assert find_collision(world, world.route, RobotModel().width_m / 2 + 0.1) is None
    line = shapely.LineString([*world.route, world.route[0]])
    crossed = [line.intersects(shapely.box(*doorway)) for doorway in DOORWAYS_M]
    assert any(crossed)
    leaves = [thing.polygon for thing in footprints(world) if thing.name.startswith("leaf_")]
    assert all(line.distance(leaf) > 0.4 for leaf in leaves)


def test_both_doorways_have_doors(world: World) -> None:
    lintels = [thing for thing in footprints(world) if thing.name.startswith("lintel_")]
    found = sorted((thing.polygon.centroid.x, thing.polygon.centroid.y) for thing in lintels)
    np.testing.assert_allclose(found, [(3.0, 2.3), (9.0, 2.3)], atol=0.06)
    assert all(thing.bottom_m == pytest.approx(2.08) for thing in lintels)


@pytest.mark.slow
def test_equal_seeds_make_equal_worlds_and_others_make_others(house: Path) -> None:
    assert built(house, 3).mjcf == built(house, 3).mjcf
    assert built(house, 3).mjcf != built(house, 4).mjcf


@pytest.mark.slow
def test_the_whole_drive_can_be_driven_either_way_round(house: Path) -> None:
    settings = SimulationSettings(plan=FloorPlan(house), seed=2, rate_hz=1)
    for is_reverse in (False, True):
        recording = simulate(replace(settings, is_reverse=is_reverse))
        assert recording.drive.is_complete, recording.drive.reason
        assert recording.name == "house-2"
    assert settings.to_dict()["world"] == "house"


@pytest.mark.slow
def test_a_drive_lasts_as_long_as_was_asked_for(house: Path) -> None:
    recording = simulate(SimulationSettings(plan=FloorPlan(house), seed=2, rate_hz=1, duration_s=150))
    assert recording.drive.duration_s == pytest.approx(150, abs=0.1)
    assert recording.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("way_m", [12.0, 80.0])
def test_a_way_is_about_as_long_as_was_asked_for(house: Path, way_m: float) -> None:
    world = built(house, 1, way_m=way_m)
    length_m = np.hypot(*np.diff(np.vstack([world.route, world.route[:1]]), axis=0).T).sum()
    assert 0.5 * way_m < length_m < 1.4 * way_m


def test_the_robot_begins_where_it_is_reported_to(house: Path) -> None:
    world = built(house, start=(3.0, 5.5, math.pi / 2))
    np.testing.assert_allclose(world.route[0], (3.0, 5.5))
    first = world.route[1] - world.route[0]
    assert math.atan2(first[1], first[0]) == pytest.approx(math.pi / 2)
    with pytest.raises(ConfigError, match=r"--start x = 0.4, y = 5 m is too near to a wall"):
        built(house, start=(0.4, 5.0, 0.0))
    with pytest.raises(ConfigError, match="too near to a wall, or off the floor"):
        built(house, start=(500.0, 5.0, 0.0))


def test_of_parts_that_are_not_joined_the_one_with_most_room_is_taken(tmp_path: Path) -> None:
    image = two_rooms()
    image[:, 60:64] = UNKNOWN  # x from 2 m: what is left of it is cut off
    world = built(write_plan(tmp_path, image))
    assert world.size_m[0] > 1.5
    assert world.route[:, 0].min() > 2.2


def test_a_plan_in_which_the_robot_fits_nowhere_says_what_is_missing(tmp_path: Path) -> None:
    image = two_rooms()
    image[::12] = 0  # 55 cm between walls
    with pytest.raises(ConfigError, match=r"widest free place of the plan is 0\.5\d? m across.*misses 0\.\d+ m"):
        built(write_plan(tmp_path, image))
    with pytest.raises(ConfigError, match="no cell of the plan is free"):
        built(write_plan(tmp_path, np.zeros((40, 40), np.uint8)))


def test_one_way_is_driven_where_there_is_no_place_to_turn(tmp_path: Path) -> None:
    image = np.full((60, 300), UNKNOWN, np.uint8)
    image[20:46, 10:290] = 254  # a corridor of 1.3 m
    world = built(write_plan(tmp_path, image))
    assert not world.is_loop
    assert abs(world.route[-1, 0] - world.route[0, 0]) > 10
    assert simulate(SimulationSettings(plan=FloorPlan(tmp_path / "house.yaml"), rate_hz=1)).drive.is_complete


def test_rooms_of_one_colour_become_areas(tmp_path: Path, house: Path) -> None:
    cv2.imwrite(str(tmp_path / "rooms.png"), rooms_in_colours())
    areas = built(house, areas=tmp_path / "rooms.png").areas
    assert len(areas) == 3
    corridor, one, other = (areas.name_at(*place) for place in ((6.0, 1.2), (3.0, 5.0), (9.0, 5.0)))
    assert len({corridor, one, other, None}) == 4
    (area,) = (area for area in areas if area.name == corridor)
    assert area.x_m is None, "a corridor of 11.6 m does not tell where along it one is"
    assert area.y_m == pytest.approx(1.2, abs=0.1)


def test_rooms_parted_by_lines_become_areas_even_round_others(tmp_path: Path) -> None:
    image = np.full((200, 200), 254, np.uint8)
    image[[0, -1]] = image[:, [0, -1]] = 0
    image[60:140, [60, 139]] = image[[60, 139], 60:140] = 0  # a room within a room
    path = write_plan(tmp_path, image)
    areas = built(path, areas=tmp_path / "plan.pgm").areas
    assert len(areas) == 2
    assert areas.name_at(4.0, 4.0) != areas.name_at(-0.5, 4.0)
    assert None not in (areas.name_at(4.0, 4.0), areas.name_at(-0.5, 4.0))


def test_an_image_of_areas_that_does_not_fit_is_refused(tmp_path: Path, house: Path) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((10, 12), np.uint8))
    with pytest.raises(AreaError, match="is 12×10 pixels, and the plan 280×204"):
        built(house, areas=tmp_path / "small.png")
    cv2.imwrite(str(tmp_path / "empty.png"), np.zeros((204, 280), np.uint8))
    with pytest.raises(AreaError, match="shows no room"):
        built(house, areas=tmp_path / "empty.png")
    with pytest.raises(MapError, match="is missing"):
        built(house, areas=tmp_path / "none.png")


@pytest.mark.slow
@pytest.mark.parametrize("times", [2, 5])
def test_plans_of_other_resolutions_make_the_same_rooms(tmp_path: Path, house: Path, times: int) -> None:
    fine = np.kron(two_rooms(), np.ones((times, times), np.uint8))
    cv2.imwrite(str(tmp_path / "fine.png"), fine)
    world = built(tmp_path / "fine.png", resolution_m=0.05 / times)
    np.testing.assert_allclose(hits(world, (4.0, 7.0), np.radians([0, 90, 180, 270])), [3, 2, 2.8, 3.6], atol=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_buildings_can_be_driven_in(data_folder: Path, name: str) -> None:
    plan = FloorPlan(data_folder / "maps" / name, REAL[name])
    recording = simulate(SimulationSettings(plan=plan, seed=5, rate_hz=1, duration_s=40, size=(64, 48)))
    assert recording.drive.duration_s == pytest.approx(40, abs=0.1)
    assert recording.world.is_loop
    frame = recording.renderer.frame(20)
    assert (frame.depth_m > 0).mean() > 0.2
    assert frame.color.std() > 5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "rooms"), [("Freiburg79_scan", 17), ("lab_ipa", 10), ("office_b", 30)])
def test_rooms_of_real_buildings_become_areas(data_folder: Path, name: str, rooms: int) -> None:
    folder = data_folder / "maps"
    areas = folder / f"{name}_gt_segmentation.png"
    world = built(folder / f"{name}.png", resolution_m=0.05, areas=areas)
    assert abs(len(world.areas) - rooms) <= 1
    assert (world.areas.index_at(world.route) >= 0).mean() > 0.8


@pytest.mark.slow
def test_furniture_keeps_clear_of_a_robot_that_begins_beside_the_route(house: Path, world: World) -> None:
    """Wherever a thing would stand a robot that turns there touches none, and all else is where it was."""
    robot = RobotModel()
    turning_m = math.hypot(robot.length_m - 0.3, robot.width_m / 2)
    usual = {thing.name: thing for thing in footprints(world) if thing.is_in_the_way}
    things = [
        name for name in usual if not name.startswith(("wall", "leaf", "lintel", "door", "floor", "jamb", "frame"))
    ]
    cleared = 0
    for name in things[::3]:
        place = usual[name].polygon.centroid
        turns = place.buffer(turning_m)
        if any(turns.intersects(thing.polygon) for thing in usual.values() if thing.name not in things):
            continue  # a wall or a door is there
        begun = build_floor_plan(FloorPlan(house), 0, robot, begin=(place.x, place.y, 0.0))
        found = {thing.name: thing for thing in footprints(begun) if thing.is_in_the_way}
        assert name not in found
        assert not any(turns.intersects(thing.polygon) for thing in found.values())
        assert all(found[one].polygon.equals(usual[one].polygon) for one in found)
        assert all(usual[one].polygon.distance(place) < turning_m + 2.5 for one in usual.keys() - found.keys())
        np.testing.assert_array_equal(begun.route, world.route)
        cleared += 1
    assert cleared >= 2


@pytest.mark.slow
def test_what_is_said_about_a_plan_is_said_of_its_world(tmp_path: Path, world: World) -> None:
    path = write_plan(tmp_path, two_rooms())
    path.write_text(path.read_text().replace("plan.pgm", "/home/somebody/plan.pgm").replace("0.0]", "-nan]"))
    found = built(path)
    assert found.mjcf == world.mjcf
    assert len(found.warnings) == 2
    assert any(warning.endswith(f"{tmp_path / 'plan.pgm'} is used") for warning in found.warnings)
    assert any("the origin's yaw is -nan" in warning for warning in found.warnings)
