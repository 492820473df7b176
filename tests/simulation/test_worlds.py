from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
import shapely

from wheelsight.core.errors import ConfigError
from wheelsight_sim.clearance import find_collision, footprints, obstacles
from wheelsight_sim.world import World
from wheelsight_sim.worlds import build_world, world_names

WORLDS = {name: build_world(name) for name in ("floor4", "flat", "studio", "blank", "square")}
EVERY_WORLD = pytest.mark.parametrize("name", WORLDS)
CLEARANCE_M = 0.55
TURNING_M = 0.83  # at waypoints, where the wheelchair turns about its driven axle and its footplates sweep
DRESSING = ("poster", "bin", "chair", "books")


def geoms(world: World) -> dict[str, dict[str, str]]:
    return {geom.attrib["name"]: dict(geom.attrib) for geom in ET.fromstring(world.mjcf).iter("geom")}


def lap(world: World) -> shapely.LineString:
    return shapely.LineString([*world.route, *world.route[:1]] if world.is_loop else world.route)


def rays(world: World, start: tuple[float, float, float], directions: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Names of the geoms hit and distances, of unit rays (N, 3)."""
    model = mujoco.MjModel.from_xml_string(world.mjcf)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    n = len(directions)
    hit, far = np.full(n, -1, np.int32), np.zeros(n)
    mujoco.mj_multiRay(model, data, np.array(start), directions.ravel(), None, 1, -1, hit, far, None, n, 1e3)
    return [model.geom(int(k)).name if k >= 0 else "" for k in hit], far


def test_the_names_are_those_that_can_be_built() -> None:
    assert world_names() == tuple(WORLDS)


@EVERY_WORLD
def test_a_world_compiles_and_nothing_in_it_moves(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(WORLDS[name].mjcf)
    assert (model.njnt, model.nmesh, model.ntex) == (0, 0, 0)
    assert 40 < model.ngeom <= 300


@EVERY_WORLD
def test_every_geom_has_a_name_and_a_material_whose_surface_is_known(name: str) -> None:
    world = WORLDS[name]
    model = mujoco.MjModel.from_xml_string(world.mjcf)
    materials = {model.mat(int(k)).name for k in model.geom_matid}
    assert (model.geom_matid >= 0).all()
    assert all(model.geom(k).name for k in range(model.ngeom))
    assert materials == set(world.surfaces)
    for material, surface in world.surfaces.items():
        np.testing.assert_allclose(model.mat(material).rgba, [*surface.rgb, 1.0], atol=1e-6)


@EVERY_WORLD
def test_surfaces_reflect_no_more_than_all_light(name: str) -> None:
    for surface in WORLDS[name].surfaces.values():
        shares = (*surface.rgb, *surface.accent_rgb, surface.contrast, surface.infrared, surface.shine)
        assert all(0 <= share <= 1 for share in shares)
        assert surface.scale_m > 0


@EVERY_WORLD
def test_what_only_decorates_is_thin_or_flat_or_out_of_reach(name: str) -> None:
    for thing in footprints(WORLDS[name]):
        sides = np.diff(shapely.get_coordinates(thing.polygon), axis=0)
        is_thin = np.hypot(*sides.T).min() < 0.05
        assert thing.is_solid or is_thin or thing.top_m < 0.01 or thing.bottom_m > 2.5, thing.name


@EVERY_WORLD
def test_a_robot_on_the_route_is_closed_in_by_floor_walls_and_ceiling(name: str) -> None:
    world = WORLDS[name]
    yaw, pitch = np.meshgrid(np.linspace(-math.pi, math.pi, 90), np.linspace(-1.5, 1.5, 25))
    around = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], -1).reshape(-1, 3)
    for x, y in world.route:
        hit, far = rays(world, (x, y, 0.9), around)
        assert "" not in hit
        assert far.min() > 0.4


@EVERY_WORLD
def test_floor_and_ceiling_are_where_they_should_be(name: str) -> None:
    world = WORLDS[name]
    x, y = world.route.mean(0) + (0.2, 0.1)
    _, far = rays(world, (x, y, 1.0), np.array([[0.0, 0, -1], [0, 0, 1]]))
    np.testing.assert_allclose(far, [1.0, 1.8], atol=0.07)  # carpets and lamps are thin
    model = mujoco.MjModel.from_xml_string(world.mjcf)
    assert model.geom("floor").contype[0] == model.geom("floor").conaffinity[0] == 1
    assert model.geom("ceiling").contype[0] == 0


@EVERY_WORLD
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_the_route_keeps_clear_of_all_that_is_solid(name: str, seed: int) -> None:
    world = build_world(name, seed)
    solid = obstacles(world)
    assert lap(world).distance(solid) >= CLEARANCE_M
    assert shapely.MultiPoint(world.route).distance(solid) >= TURNING_M
    assert find_collision(world, world.route, CLEARANCE_M) is None


@EVERY_WORLD
def test_the_seed_changes_dressing_but_neither_walls_nor_route_nor_areas(name: str) -> None:
    first, other = build_world(name, 1), build_world(name, 2)
    assert first.mjcf != other.mjcf
    np.testing.assert_array_equal(first.route, other.route)
    assert first.areas.names == other.areas.names
    assert [area.polygon.tolist() for area in first.areas.areas] == [
        area.polygon.tolist() for area in other.areas.areas
    ]
    before, after = geoms(first), geoms(other)
    assert before.keys() == after.keys()
    changed = {geom for geom in before if before[geom] != after[geom]}
    assert any(geom.startswith("poster") for geom in changed)
    assert all(any(kind in geom for kind in DRESSING) for geom in changed)


@EVERY_WORLD
def test_the_seed_changes_paint_a_little_but_not_what_shows_nothing(name: str) -> None:
    first, other = build_world(name, 1), build_world(name, 2)
    common = first.surfaces.keys() & other.surfaces.keys()
    off = {material: np.subtract(first.surfaces[material].rgb, other.surfaces[material].rgb) for material in common}
    assert 0 < max(np.abs(difference).max() for difference in off.values()) < 0.15
    assert not any(off[material].any() for material in common if first.surfaces[material].contrast == 0)


@EVERY_WORLD
def test_the_same_seed_gives_the_same_world(name: str) -> None:
    assert build_world(name, 5).mjcf == build_world(name, 5).mjcf
    assert build_world(name, 5).surfaces == build_world(name, 5).surfaces


@pytest.mark.parametrize("name", ["floor4", "flat", "studio", "square"])
def test_on_another_day_chairs_and_bins_stand_elsewhere_and_nothing_else_does(name: str) -> None:
    first, other, again = build_world(name, 1), build_world(name, 1, day=1), build_world(name, 1, day=1)
    before, after = geoms(first), geoms(other)
    assert before.keys() == after.keys()
    assert first.surfaces == other.surfaces
    moved = {geom for geom in before if before[geom] != after[geom]}
    assert moved
    assert all("chair" in geom or "bin" in geom for geom in moved)
    assert other.mjcf == again.mjcf != build_world(name, 1, day=2).mjcf
    assert find_collision(other, other.route, CLEARANCE_M) is None


def test_areas_do_not_overlap() -> None:
    for world in WORLDS.values():
        polygons = [shapely.Polygon(area.polygon) for area in world.areas.areas]
        union = shapely.union_all(polygons).area
        assert union == pytest.approx(sum(polygon.area for polygon in polygons))
        assert all(polygon.is_valid for polygon in polygons)


@pytest.mark.parametrize("name", ["floor4", "flat", "studio", "blank"])
def test_the_areas_cover_the_whole_route(name: str) -> None:
    way = lap(WORLDS[name])
    points = [way.interpolate(along) for along in np.arange(0.0, way.length, 0.1)]
    found = WORLDS[name].areas.index_at([(point.x, point.y) for point in points])
    assert (found >= 0).all()
    assert set(found) == set(range(len(WORLDS[name].areas.areas)))


def test_floor4_shows_the_coordinates_that_the_paper_shows() -> None:
    areas = WORLDS["floor4"].areas.areas
    assert [area.name for area in areas] == list("12345678")
    both = [area.name for area in areas if area.x_m is not None and area.y_m is not None]
    assert both == ["2", "4", "5", "6"]
    for area in areas:
        width_m, depth_m = np.ptp(area.polygon, axis=0)
        assert (area.x_m is None) + (area.y_m is None) == (area.name not in both)
        if area.name in both:
            assert max(width_m, depth_m) <= 10
        else:
            assert (area.x_m is None) == (width_m > depth_m), "a corridor does not tell the coordinate it runs along"


def test_floor4_coordinates_are_near_anyone_who_is_in_the_area() -> None:
    world = WORLDS["floor4"]
    way = lap(world)
    points = np.array([shapely.get_coordinates(way.interpolate(along))[0] for along in np.arange(0, way.length, 0.1)])
    found = world.areas.index_at(points)
    for index, area in enumerate(world.areas.areas):
        here = points[found == index]
        if area.x_m is not None:
            assert np.abs(here[:, 0] - area.x_m).max() <= 5
        if area.y_m is not None:
            assert np.abs(here[:, 1] - area.y_m).max() <= 5


def test_a_lap_of_floor4_is_longer_than_100_m_and_as_long_as_it_says() -> None:
    world = WORLDS["floor4"]
    assert lap(world).length > 100
    assert f"a lap of {lap(world).length:.0f} m" in world.description


def test_doorways_of_floor4_let_a_camera_look_into_rooms() -> None:
    hit, far = rays(WORLDS["floor4"], (9.5, 1.4, 0.9), np.array([[0.0, 1.0, 0.0]]))
    assert hit[0].startswith("office")
    assert far[0] > 3


def test_the_blank_corridor_shows_nothing_for_25_m() -> None:
    world = WORLDS["blank"]
    begin, end = WORLDS["blank"].areas.areas[1].polygon[:2, 0].tolist()
    assert end - begin >= 25
    yaw, pitch = np.meshgrid(np.radians(np.linspace(60, 120, 15)), np.radians(np.linspace(-30, 65, 20)))
    left = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], -1).reshape(-1, 3)
    seen = set()
    for x in np.arange(begin + 1.5, end - 1.5, 1.0):
        seen |= set(rays(world, (x, 1.2, 0.9), left)[0]) | set(rays(world, (x, 1.2, 0.9), -left)[0])
    materials = {geoms(world)[geom]["material"] for geom in seen}
    assert seen == {"wall_south", "wall_north", "floor", "ceiling"}
    assert all(world.surfaces[material].kind == "plain" for material in materials)
    assert all(world.surfaces[material].contrast == 0 for material in materials)


def test_the_square_is_umbmarks() -> None:
    world = WORLDS["square"]
    assert world.is_loop
    np.testing.assert_array_equal(world.route, [(0, 0), (4, 0), (4, 4), (0, 4)])


def test_doorways_of_the_flat_are_wide_enough_for_a_wheelchair() -> None:
    narrow = WORLDS["flat"].route
    assert find_collision(WORLDS["flat"], narrow, 0.45) is None
    assert find_collision(WORLDS["flat"], narrow, 0.65) is not None


@pytest.mark.parametrize(("name", "hint"), [("floor5", "did you mean floor4? "), ("moon", "")])
def test_an_unknown_world_is_refused_with_the_names(name: str, hint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build_world(name)
    assert str(caught.value) == f"there is no world {name} ({hint}choose from floor4, flat, studio, blank, square)"


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError, match="seed is -1"):
        build_world("square", -1)


HALL = """
<mujoco>
  <asset><material name="stone" rgba="0.5 0.5 0.5 1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1" material="stone"/>
    <geom name="post" type="cylinder" size="0.5 1" pos="3 2 1" material="stone"/>
    <geom name="bar" type="box" size="1 0.1 0.5" pos="-2 0 0.5" euler="0 0 90" material="stone"/>
    <geom name="sill" type="box" size="1 1 0.02" pos="0 -3 0.02" material="stone"/>
    <geom name="lintel" type="box" size="1 1 0.5" pos="0 -3 1.6" material="stone"/>
    <geom name="picture" type="box" size="1 1 0.5" pos="0 3 0.5" material="stone" contype="0" conaffinity="0"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def hall() -> World:
    """A floor of 10 m by 10 m with a round post, a turned bar, and things that are in nobody's way."""
    route = np.array([(0.0, 0.0), (1.0, 0.0)])
    areas = WORLDS["square"].areas
    return World("hall", "a hall", HALL, WORLDS["square"].surfaces, areas, route, False, (-5, -5, 5, 5))


def test_obstacles_are_what_is_solid_between_floor_and_wheelchair(hall: World) -> None:
    expected = shapely.union_all([shapely.Point(3, 2).buffer(0.5), shapely.box(-2.1, -1, -1.9, 1)])
    assert obstacles(hall).symmetric_difference(expected).area < 1e-9
    assert [thing.name for thing in footprints(hall) if thing.is_in_the_way] == ["post", "bar"]


def test_a_footprint_shows_heights_and_material(hall: World) -> None:
    lintel = next(thing for thing in footprints(hall) if thing.name == "lintel")
    assert (lintel.bottom_m, lintel.top_m) == pytest.approx((1.1, 2.1))
    assert lintel.material == "stone"


def test_the_first_touch_is_where_the_disc_meets_the_post(hall: World) -> None:
    collision = find_collision(hall, [(0, 0), (0, 2), (4.2, 2)], 0.3)
    assert collision is not None
    assert collision.geom == "post"
    assert collision.place == pytest.approx((3 - 0.5 - 0.3, 2), abs=1e-3)


def test_the_nearer_of_two_obstacles_is_named(hall: World) -> None:
    assert find_collision(hall, [(4.2, 0.9), (-4, 0.9)], 0.7).geom == "post"  # type: ignore[union-attr]
    assert find_collision(hall, [(-4, 0.9), (4.2, 0.9)], 0.7).geom == "bar"  # type: ignore[union-attr]


def test_a_route_may_pass_under_lintels_over_sills_and_through_pictures(hall: World) -> None:
    assert find_collision(hall, [(0, -4), (0, 4)], 0.3) is None


def test_the_way_back_of_a_loop_is_checked_too(hall: World) -> None:
    round_the_bar = [(-3, -2), (0, -2), (0, 2), (-3, 2)]
    assert find_collision(hall, round_the_bar, 0.3, is_loop=True) is None
    across = [(0, 0), (0, 2), (-3.5, 2), (-3.5, 0)]
    assert find_collision(hall, across, 0.3) is None
    collision = find_collision(hall, across, 0.3, is_loop=True)
    assert collision is not None
    assert (collision.geom, collision.place[1]) == ("bar", 0)


def test_a_route_off_the_floor_collides(hall: World) -> None:
    collision = find_collision(hall, [(0, 0), (0, 7)], 0.3)
    assert collision is not None
    assert collision.geom is None


def test_a_route_through_a_wall_names_the_wall() -> None:
    collision = find_collision(WORLDS["floor4"], [(4, 1.4), (20, 1.4), (20, 10)], 0.4, is_loop=False)
    assert collision is not None
    assert (collision.geom, collision.place[0]) == ("wall_core_south_2", 20)


@pytest.mark.parametrize("route", [[(0, 0)], [], [(0, 0, 0), (1, 1, 1)], [(0, 0), (math.nan, 1)]])
def test_what_is_no_route_is_refused(hall: World, route: list[tuple[float, ...]]) -> None:
    with pytest.raises(ConfigError, match="waypoint"):
        find_collision(hall, route, 0.3)
