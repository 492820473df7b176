"""Costmaps: layers, distances and costs, by closed forms and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from navigation.floors import CHAIR, costmap_of, static_of
from scipy.ndimage import distance_transform_edt

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import se2
from wheelsight.mapping.map_edits import EditKind, MapEdit, MapEdits
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid
from wheelsight.navigation import CellState, Costmap, CostmapSettings, LiveObstacles, StaticLayer

SQUARE = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])


def grid() -> OccupancyGrid:
    kind = np.full((60, 80), CellKind.FREE, np.uint8)
    kind[10, 10], kind[10, 20], kind[10, 40] = CellKind.OBSTACLE, CellKind.DROP_OFF, CellKind.OVERHANG
    kind[9:13, 29:33] = CellKind.UNKNOWN
    return OccupancyGrid.of_kinds(kind, kind == CellKind.OVERHANG, 0.05, (0.0, 0.0))


def live(is_occupied: np.ndarray, origin: tuple[float, float] = (0.0, 0.0)) -> LiveObstacles:
    return LiveObstacles(is_occupied, 0.05, origin, "odom", 1.0, is_occupied)


@pytest.mark.parametrize(
    ("side", "neighbour", "expected"),
    [
        (2, CellKind.FREE, CellState.FREE),
        (4, CellKind.FREE, CellState.UNKNOWN),
        (2, CellKind.OBSTACLE, CellState.UNKNOWN),
    ],
)
def test_holes_too_small_for_anything_are_floor(side: int, neighbour: CellKind, expected: CellState) -> None:
    kind = np.full((20, 20), CellKind.FREE, np.uint8)
    kind[8 : 8 + side, 8 : 8 + side] = CellKind.UNKNOWN
    kind[7, 8] = neighbour
    layer = StaticLayer.of(OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, 0.05, (0.0, 0.0)))
    assert (layer.state[8 : 8 + side, 8 : 8 + side] == expected).all()


def test_the_static_layer_says_what_the_map_and_its_edits_say() -> None:
    edits = MapEdits(
        (
            MapEdit(EditKind.KEEP_OUT, SQUARE),
            MapEdit(EditKind.SPEED, SQUARE + [1.0, 0.0], limit_m_s=0.3),
            MapEdit(EditKind.WIPED, np.array([[0.4, 0.4], [0.6, 0.4], [0.6, 0.6], [0.4, 0.6]])),
        )
    )
    plain, edited = StaticLayer.of(grid()), StaticLayer.of(grid(), edits)
    cells = [(10, 10), (10, 20), (10, 30), (10, 40), (30, 30)]
    states = [CellState.OCCUPIED, CellState.OCCUPIED, CellState.UNKNOWN, CellState.FREE, CellState.FREE]
    assert [plain.state[cell] for cell in cells] == states
    assert edited.state[10, 10] == CellState.FREE
    assert edited.state[30, 30] == CellState.OCCUPIED
    assert np.isinf(plain.speed_m_s).all()
    assert edited.speed_m_s[30, 50] == np.float32(0.3)
    assert np.isinf(edited.speed_m_s[30, 70])


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.01, 0.3]))
def test_distances_are_exact(seed: int, share: float) -> None:
    is_occupied = np.random.default_rng(seed).random((50, 70)) < share
    found = costmap_of(is_occupied, 0.1).distance_m
    expected = 0.1 * distance_transform_edt(~is_occupied) if is_occupied.any() else np.full((50, 70), 100.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_cost_falls_with_distance_from_where_the_robot_can_never_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wheelsight.navigation.costmap._DECAY_PER_M", 4.0)
    is_occupied = np.zeros((3, 60), bool)
    is_occupied[:, 0] = True
    costmap = costmap_of(is_occupied, 0.05, CostmapSettings(inflation_m=0.5))
    # From the edge of the wall, at 0.05 m, to cells' middles.
    apart_m = 0.05 * (np.arange(1, 60) - 0.5)
    expected = np.where(apart_m - 0.3 > 0.5, 0, np.exp(-4 * np.maximum(apart_m - 0.3, 0)))
    np.testing.assert_allclose(costmap.cost[1, 1:], expected, atol=1e-5)
    assert costmap.cost[1, 0] == 1


@pytest.mark.parametrize(("policy", "is_lethal", "cost"), [("forbidden", True, 1.0), ("costly", False, 0.7)])
def test_the_unknown_is_forbidden_or_costs(policy: str, is_lethal: bool, cost: float) -> None:
    settings = CostmapSettings.model_validate({"unknown": policy, "unknown_cost": 0.7})
    state = np.full((60, 60), CellState.FREE, np.uint8)
    state[30, 30] = CellState.UNKNOWN
    static = StaticLayer(state, np.full(state.shape, np.inf, np.float32), 0.05, (0.0, 0.0))
    costmap = Costmap.of(static, CHAIR, settings)
    assert costmap.is_lethal[30, 30] == is_lethal
    assert costmap.cost[30, 30] == pytest.approx(cost)
    assert (costmap.cost[30, 32] > 0) == is_lethal


def test_floor_under_a_robot_that_stands_there_is_known() -> None:
    state = np.full((80, 80), CellState.UNKNOWN, np.uint8)
    state[40, 40] = CellState.OCCUPIED
    static = StaticLayer(state, np.full(state.shape, np.inf, np.float32), 0.05, (0.0, 0.0))
    costmap = Costmap.of(static, CHAIR)
    stood = costmap.standing_at(CHAIR, (2.0, 2.0, 0.0))
    known = np.zeros((80, 80), bool)
    known[34:46, 34:56] = True  # 1.7 to 2.8 m, 1.7 to 2.3 m; and what the outline touches
    assert (stood.state[known] != CellState.UNKNOWN).all()
    assert stood.state[40, 40] == CellState.OCCUPIED
    assert (stood.state[32] == CellState.UNKNOWN).all()
    assert (stood.state[:, 58] == CellState.UNKNOWN).all()
    assert (costmap.state == state).all()
    turned = costmap.standing_at(CHAIR, (2.0, 2.0, np.pi / 2))
    np.testing.assert_array_equal(turned.state == CellState.FREE, (stood.state == CellState.FREE).T)
    assert costmap.standing_at(CHAIR, (50.0, 2.0, 0.0)) is costmap


def test_a_live_cell_beside_an_obstacle_of_the_map_is_that_obstacle_and_makes_no_door_narrower() -> None:
    is_wall, seen = np.zeros((40, 40), bool), np.zeros((40, 40), bool)
    is_wall[20, :15] = is_wall[20, 25:] = True
    seen[19:22, 13:16] = seen[20, 24] = True  # the ends of the wall, a cell too large
    seen[20, 18] = seen[17, 5] = True  # things in the door, and 0.15 m before the wall
    costmap = Costmap.of(static_of(is_wall), CHAIR, None, live(seen))
    expected = is_wall.copy()
    expected[20, 18] = expected[17, 5] = True
    np.testing.assert_array_equal(costmap.is_lethal, expected)


@given(st.floats(-np.pi, np.pi), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01))
def test_seen_obstacles_of_the_map_add_nothing_however_their_frame_lies(yaw: float, x: float, y: float) -> None:
    """A live cell across two cells of the map marks both, so it is compared before, and not cell by cell after."""
    is_wall = np.zeros((40, 40), bool)
    is_wall[18:24, 15:27] = True
    T = se2.from_parts(x, y, yaw)
    away = se2.apply(se2.invert(T), (np.argwhere(is_wall)[:, ::-1] + 0.5) * 0.05)
    seen, origin = np.zeros((120, 120), bool), (-3.0, -3.0)
    at = np.floor((away[:, ::-1] - origin) / 0.05).astype(int)
    seen[at[:, 0], at[:, 1]] = True
    costmap = Costmap.of(static_of(is_wall), CHAIR, None, live(seen, origin), (x, y, yaw))
    np.testing.assert_array_equal(costmap.is_lethal, is_wall)


def test_a_live_cell_on_unknown_floor_beside_an_obstacle_stays() -> None:
    state = np.full((40, 40), CellState.UNKNOWN, np.uint8)
    state[20, 20] = CellState.OCCUPIED
    static = StaticLayer(state, np.full(state.shape, np.inf, np.float32), 0.05, (0.0, 0.0))
    seen = np.zeros((40, 40), bool)
    seen[20, 21] = True
    costmap = Costmap.of(static, CHAIR, CostmapSettings(unknown="costly"), live(seen))
    assert np.argwhere(costmap.is_lethal).tolist() == [[20, 20], [20, 21]]


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-np.pi, np.pi), st.integers(0, 10**6))
def test_live_obstacles_stand_where_their_frame_puts_them(x: float, y: float, yaw: float, seed: int) -> None:
    """Points in an occupied cell of theirs lie in occupied cells of the map, but for slivers at its rim."""
    rng = np.random.default_rng(seed)
    is_occupied = rng.random((30, 30)) < 0.05
    costmap = Costmap.of(
        static_of(np.zeros((200, 200), bool), origin=(-5.0, -5.0)),
        CHAIR,
        None,
        live(is_occupied, (-0.7, -0.7)),
        (x, y, yaw),
    )
    cells = np.argwhere(is_occupied)
    inner = (cells[:, None, ::-1] + rng.uniform(0.13, 0.87, (len(cells), 20, 2))) * 0.05 - 0.7
    c, s = np.cos(yaw), np.sin(yaw)
    places = inner @ np.array([[c, s], [-s, c]]) + (x, y)
    rows, columns = np.moveaxis(costmap.cells_at(places), -1, 0)
    inside = (rows >= 0) & (rows < 200) & (columns >= 0) & (columns < 200)
    hit = costmap.is_lethal[rows[inside], columns[inside]]
    assert hit.mean() > 0.97 if hit.size else not inside.any()
    assert np.count_nonzero(costmap.is_lethal) <= 5 * len(cells)


def test_live_obstacles_free_nothing_that_the_map_has() -> None:
    static = static_of(np.eye(40, dtype=bool))
    same = Costmap.of(static, CHAIR, None, live(np.zeros((40, 40), bool)))
    np.testing.assert_array_equal(same.is_lethal, np.eye(40, dtype=bool))
    alone = Costmap.of_live(live(np.eye(40, dtype=bool)), CHAIR)
    np.testing.assert_array_equal(alone.is_lethal, np.eye(40, dtype=bool))
    assert (alone.frame, same.frame) == ("odom", "map")


@pytest.mark.parametrize("T", [(np.nan, 0.0, 0.0), (0.0, 0.0), (0.0, 0.0, np.inf)])
def test_a_frame_that_is_nowhere_is_refused(T: tuple[float, ...]) -> None:
    with pytest.raises(ArgumentError, match="T_map_live"):
        Costmap.of(static_of(np.zeros((10, 10), bool)), CHAIR, None, live(np.ones((10, 10), bool)), T)


def test_the_state_at_points_is_that_of_their_cells_and_unknown_beyond() -> None:
    grid = OccupancyGrid.of_kinds(
        np.array([[CellKind.FREE, CellKind.OBSTACLE]], np.uint8), np.zeros((1, 2), bool), 0.1, (1.0, 2.0)
    )
    layer = StaticLayer.of(grid)
    found = layer.state_at([[1.05, 2.05], [1.15, 2.01], [1.25, 2.05], [1.05, 1.99]])
    assert found.tolist() == [CellState.FREE, CellState.OCCUPIED, CellState.UNKNOWN, CellState.UNKNOWN]
