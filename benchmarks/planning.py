"""`python -m benchmarks.planning`: plans of a wheelchair in floor plans of real buildings, and times beside peers.

Goals are drawn at random where the chair fits, in the largest part of the floor that is joined for its inscribed
circle. Only the plan shows whether a chair of that length can go from one to another: a share below 1 is no fault by
itself.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from benchmarks import machine
from benchmarks.navigation_page import write_section
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray
from wheelsight.io.ros_map import FREE, OCCUPIED, read_ros_map
from wheelsight.mapping.occupancy import CellKind, OccupancyGrid
from wheelsight.navigation import (
    Costmap,
    Footprint,
    Plan,
    PlanFailure,
    Planner,
    PlannerSettings,
    StaticLayer,
    cost_to_go,
)

CHAIR = Footprint.rectangle(front_m=0.8, back_m=0.3, width_m=0.6)
BARE_RESOLUTION_M = 0.05
PLANS = (
    *("Freiburg79_scan.png", "lab_ipa.png", "office_b.png", "basement_fixed.map.yaml"),
    *("ctrl_room.yaml", "indoor.yaml", "map_real.yaml", "willow-2010-02-18-0.10.yaml"),
)
_SIDE, _REPEATS, _GOALS, _SEED = 1000, 5, 20, 1
_BOX_M, _REPAIR_MS = 1.6, 50.0
_OURS, _PLAN_MS, _TITLE = "ours", 150.0, "Plans of a wheelchair"
_HEADER = (
    *("building", "found", "by search", "way m", "backward m", "clearance m", "shortest over ours"),
    *("median s", "most s", "none, since"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """One plan that was asked for; `shortest_m` is a circle's way over the cells, some percent too long."""

    start: FloatArray
    goal: FloatArray
    answer: Plan | PlanFailure
    seconds: float
    shortest_m: float


def grid_of(path: Path) -> OccupancyGrid:
    """A floor plan as an occupancy grid, along its own axes."""
    plan = read_ros_map(path, BARE_RESOLUTION_M if path.suffix == ".png" else None)
    kind = np.full(plan.occupancy.shape, CellKind.UNKNOWN, np.uint8)
    kind[plan.occupancy == FREE], kind[plan.occupancy >= OCCUPIED] = CellKind.FREE, CellKind.OBSTACLE
    return OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, plan.resolution_m, plan.origin[:2])


def poses_in(costmap: Costmap, count: int, rng: np.random.Generator) -> FloatArray:
    """(count, 3) at which the chair fits with 10 cm to spare, in the largest part of the floor."""
    room = _largest(costmap.distance_m > CHAIR.inscribed_m + 0.5 * costmap.resolution_m)
    cells = np.argwhere(room)
    poses: list[FloatArray] = []
    spare = CHAIR.padded(0.1)
    while len(poses) < count:
        x, y = costmap.middle_of(cells[rng.integers(len(cells))])
        pose = np.array([x, y, rng.uniform(-np.pi, np.pi)])
        # Points of the outline and within, a quarter of a cell apart: of goals they need not be exact.
        low, high = spare.corners.min(axis=0), spare.corners.max(axis=0)
        steps = [np.arange(a, b, costmap.resolution_m / 4) for a, b in zip(low, high, strict=True)]
        inner = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        at = costmap.cells_at(inner @ np.array([[c, s], [-s, c]]) + pose[:2])
        if (at >= 0).all() and (at < costmap.state.shape).all() and not costmap.is_lethal[at[:, 0], at[:, 1]].any():
            poses.append(pose)
    return np.array(poses)


def _largest(room: BoolArray) -> BoolArray:
    from scipy.ndimage import label

    labels, _ = label(room)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(labels == sizes.argmax())


def asked_in(grid: OccupancyGrid, goals: int, seed: int) -> Iterator[Asked]:
    """Plans from one random pose to the next."""
    costmap = Costmap.of(StaticLayer.of(grid), CHAIR)
    poses = poses_in(costmap, goals + 1, np.random.default_rng(seed))
    planner = Planner(CHAIR)
    for start, goal in pairwise(poses):
        begin = time.perf_counter()
        answer = planner.plan(costmap, start, goal)
        seconds = time.perf_counter() - begin
        yield Asked(start, goal, answer, seconds, _shortest_m(costmap, start, goal))


def _shortest_m(costmap: Costmap, start: FloatArray, goal: FloatArray) -> float:
    """Of the inscribed circle with the planner's least margin; no chair has a shorter one but for the grid's angles."""
    blocked = costmap.distance_m < CHAIR.inscribed_m + PlannerSettings().margin_m
    metre_cost = np.where(blocked, np.inf, 1).astype(np.float32)
    row, column = costmap.cells_at(goal[:2]).tolist()
    return float(cost_to_go(metre_cost, costmap.resolution_m, (row, column))[tuple(costmap.cells_at(start[:2]))])


def row_of(name: str, asked: Sequence[Asked]) -> tuple[str, ...]:
    """Of a building's plans, as `_HEADER` has it."""
    found = [(one, one.answer) for one in asked if isinstance(one.answer, Plan)]
    why = Counter(one.answer.reason.name for one in asked if isinstance(one.answer, PlanFailure))
    seconds = np.array([one.seconds for one in asked])
    clear = min((plan.least_clearance_m for _, plan in found), default=np.nan)
    ratio = np.mean([min(one.shortest_m / max(plan.length_m, 1e-9), 1.0) for one, plan in found])
    return (
        name,
        f"{len(found)} of {len(asked)}",
        str(sum(plan.states > 0 for _, plan in found)),
        f"{sum(plan.length_m for _, plan in found):.0f}",
        f"{sum(_backward_m(plan) for _, plan in found):.1f}",
        f"{clear:.3f}",
        f"{ratio:.3f}",
        f"{np.median(seconds):.2f}",
        f"{seconds.max():.2f}",
        ", ".join(f"{count} {reason}" for reason, count in why.items()) or "—",
    )


def _backward_m(plan: Plan) -> float:
    steps = np.hypot(*np.diff(plan.poses[:, :2], axis=0).T)
    return float(steps[plan.directions[1:] < 0].sum())


def graph_of(metre_cost: Float32Array) -> csr_matrix:
    """Cells and the costs of steps between neighbours, for csgraph; no step cuts the corner of a blocked cell."""
    rows, columns = metre_cost.shape
    numbers = np.arange(rows * columns).reshape(rows, columns)
    is_free = np.isfinite(metre_cost)
    begin, end, cost = [], [], []
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = slice(0, rows - i), slice(max(-j, 0), columns - max(j, 0))
        b = slice(i, rows), slice(max(j, 0), columns + min(j, 0))
        joined = is_free[a] & is_free[b]
        if i and j:
            joined &= is_free[a[0], b[1]] & is_free[b[0], a[1]]
        begin.append(numbers[a][joined])
        end.append(numbers[b][joined])
        mean = 0.5 * (metre_cost[a][joined] + metre_cost[b][joined])
        cost.append(np.hypot(i, j) * mean)
    ends = np.concatenate(begin), np.concatenate(end)
    return csr_matrix((np.concatenate(cost), ends), shape=(rows * columns, rows * columns))


def timed_cost_to_go() -> dict[str, float]:
    """Median milliseconds for 1000 × 1000 cells, ours and peers', in alternation."""
    rng = np.random.default_rng(_SEED)
    metre_cost = (1 + 2 * rng.random((_SIDE, _SIDE))).astype(np.float32)
    metre_cost[rng.random(metre_cost.shape) < 0.1] = np.inf
    metre_cost[_SIDE // 2, _SIDE // 2] = 1
    cost_to_go(metre_cost[:50, :50].copy(), 1.0, (25, 25))
    graph = graph_of(metre_cost)
    ways: dict[str, Callable[[], float]] = {
        _OURS: lambda: _timed_ours(metre_cost),
        "csgraph's Dijkstra, its graph being made": lambda: _timed_csgraph(graph),
        "scikit-image's MCP": lambda: _timed_skimage(metre_cost),
    }
    kept = [[timed() for timed in ways.values()] for _ in range(_REPEATS)]
    return dict(zip(ways, (1e3 * np.median(kept, axis=0)).tolist(), strict=True))


def rooms() -> OccupancyGrid:
    """50 × 50 m of rooms of 5 m, 1000 × 1000 cells: each has a door of 1.2 m to each of its neighbours, askew."""
    kind = np.full((_SIDE, _SIDE), CellKind.FREE, np.uint8)
    rng, side, door = np.random.default_rng(_SEED), 100, 24
    for wall in range(0, _SIDE, side):
        kind[wall : wall + 3] = kind[:, wall : wall + 3] = CellKind.OBSTACLE
    kind[-3:] = kind[:, -3:] = CellKind.OBSTACLE
    for wall in range(side, _SIDE, side):
        for room in range(0, _SIDE, side):
            first, other = room + rng.integers(10, side - door - 10, 2)
            kind[wall : wall + 3, first : first + door] = CellKind.FREE
            kind[other : other + door, wall : wall + 3] = CellKind.FREE
    return OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, BARE_RESOLUTION_M, (0.0, 0.0))


def timed_plan() -> tuple[float, float]:
    """Median milliseconds of a whole plan through those rooms from corner to corner, and how long it is in metres.

    Raises:
        RuntimeError: there is none, so that what was measured is no plan.
    """
    costmap, planner = Costmap.of(StaticLayer.of(rooms()), CHAIR), Planner(CHAIR)
    spent, length_m = [], np.nan
    for _ in range(_REPEATS):
        begin = time.perf_counter()
        answer = planner.plan(costmap, np.array([2.5, 2.5, 0.0]), np.array([47.5, 47.5, 0.0]))
        spent.append(time.perf_counter() - begin)
        if not isinstance(answer, Plan):
            raise RuntimeError(f"no plan: {answer.detail}")
        length_m = answer.length_m
    return 1e3 * float(np.median(spent)), length_m


def timed_repair() -> tuple[float, float]:
    """Median milliseconds of the repair of that plan, which a box of 0.4 m blocks after 1.6 m, and its cost over that
    of a whole plan.

    Raises:
        RuntimeError: there is none, so that what was measured is no repair.
    """
    start, goal, kind = np.array([2.5, 2.5, 0.0]), np.array([47.5, 47.5, 0.0]), rooms().kind.copy()
    planner = Planner(CHAIR)
    before = planner.plan(Costmap.of(StaticLayer.of(rooms()), CHAIR), start, goal)
    if not isinstance(before, Plan):
        raise RuntimeError(f"no plan: {before.detail}")
    along = np.cumsum(np.hypot(*np.diff(before.poses[:, :2], axis=0).T))
    column, row = (before.poses[int(np.searchsorted(along, _BOX_M)), :2] / BARE_RESOLUTION_M).astype(int)
    kind[row - 4 : row + 4, column - 4 : column + 4] = CellKind.OBSTACLE
    grid = OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, BARE_RESOLUTION_M, (0.0, 0.0))
    costmap, spent = Costmap.of(StaticLayer.of(grid), CHAIR), []
    whole, repaired = planner.plan(costmap, start, goal), None
    for _ in range(_REPEATS):
        begin = time.perf_counter()
        repaired = planner.repaired(costmap, before, start)
        spent.append(time.perf_counter() - begin)
    if repaired is None or not isinstance(whole, Plan):
        raise RuntimeError("no repair")
    return 1e3 * float(np.median(spent)), repaired.cost / whole.cost


def _timed_ours(metre_cost: Float32Array) -> float:
    begin = time.perf_counter()
    cost_to_go(metre_cost, 1.0, (_SIDE // 2, _SIDE // 2))
    return time.perf_counter() - begin


def _timed_csgraph(graph: csr_matrix) -> float:
    begin = time.perf_counter()
    dijkstra(graph, directed=False, indices=_SIDE // 2 * _SIDE + _SIDE // 2)
    return time.perf_counter() - begin


def _timed_skimage(metre_cost: Float32Array) -> float:
    from skimage.graph import MCP_Geometric

    costs = np.where(np.isfinite(metre_cost), metre_cost, -1).astype(float)
    begin = time.perf_counter()
    MCP_Geometric(costs).find_costs([(_SIDE // 2, _SIDE // 2)])
    return time.perf_counter() - begin


def picture_of(grid: OccupancyGrid, asked: Sequence[Asked], px: int = 2) -> ByteArray:
    """(h, w, 3) red, green, blue: the floor, the outlines of plans, and where they end."""
    import cv2

    shades = np.where(grid.occupancy == FREE, 255, np.where(grid.occupancy == OCCUPIED, 40, 200)).astype(np.uint8)
    image = np.repeat(shades[::-1].repeat(px, axis=0).repeat(px, axis=1)[..., None], 3, axis=2).copy()

    def at(points: FloatArray) -> np.ndarray:
        cells = (points - grid.origin) / grid.resolution_m * px
        return np.asarray(np.rint(np.stack([cells[..., 0], image.shape[0] - cells[..., 1]], axis=-1)), np.int32)

    for one in asked:
        if isinstance(one.answer, Plan):
            every = np.unique(np.r_[np.arange(0, len(one.answer.poses), 6), len(one.answer.poses) - 1])
            for k in every:
                colour = (0, 114, 178) if one.answer.directions[k] > 0 else (213, 94, 0)
                cv2.polylines(image, [at(CHAIR.at(one.answer.poses[k]))], True, colour, 1, cv2.LINE_AA)
            cv2.polylines(image, [at(one.answer.poses[:, :2])], False, (0, 158, 115), 2, cv2.LINE_AA)
        else:
            cv2.drawMarker(image, at(one.goal[:2]).tolist(), (204, 0, 0), cv2.MARKER_CROSS, 12, 2)
    return image


def time_sheets() -> list[Sheet]:
    """Measured now: beside peers, and what must be reached."""
    ms, (plan_ms, plan_m) = timed_cost_to_go(), timed_plan()
    rows = [(name, f"{one:.0f}", f"{one / ms[_OURS]:.1f}") for name, one in ms.items()]
    rows.append((f"a whole plan of ours, {plan_m:.0f} m through rooms and doors", f"{plan_ms:.0f}", "—"))
    repair_ms, cost = timed_repair()
    rows.append((f"its repair before a box, {cost:.3f} of a whole plan's cost", f"{repair_ms:.0f}", "—"))
    targets = [
        Target("cost to go of 1000 × 1000 cells", _PLAN_MS, ms[_OURS], "ms", 0),
        Target("a whole plan over 1000 × 1000 cells", _PLAN_MS, plan_ms, "ms", 0),
        Target("a repair of it", _REPAIR_MS, repair_ms, "ms", 0),
    ]
    return [
        Sheet("1000 × 1000 cells, median ms", ("what", "ms", "times ours"), tuple(rows)),
        targets_sheet(targets),
    ]


def plans_in(name: str, goals: int, seed: int, pictures: Path | None) -> tuple[str, ...] | None:
    """Of a building, with a picture in a folder; None where its file is not there."""
    path = default_data_folder() / "maps" / name
    if not path.exists():
        print(f"{name}: left out, {path} is not there")
        return None
    grid = grid_of(path)
    asked = list(asked_in(grid, goals, seed))
    if pictures is not None:
        import cv2

        pictures.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(pictures / f"{path.stem}.png"), picture_of(grid, asked)[..., ::-1])
    return row_of(name, asked)


def main(words: Sequence[str] | None = None) -> int:
    """Print all figures, and write them where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning", description=__doc__)
    parser.add_argument("--goals", type=int, default=_GOALS, help="a building")
    parser.add_argument("--seed", type=int, default=_SEED)
    parser.add_argument("--only", default="", help="buildings whose names hold this")
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each building")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    arguments = parser.parse_args(words)
    what = f"--goals {arguments.goals} --seed {arguments.seed}"
    about = machine.description() | {"Command": f"`python -m benchmarks.planning {what}`"}
    console, named = Console(width=150), [name for name in PLANS if arguments.only in name]
    found = (plans_in(name, arguments.goals, arguments.seed, arguments.pictures) for name in named)
    rows = tuple(row for row in found if row is not None)
    sheets = [*time_sheets(), Sheet("Plans in floor plans of real buildings", _HEADER, rows)]
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_section(arguments.out, _TITLE, __doc__ or "", about, sheets)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
