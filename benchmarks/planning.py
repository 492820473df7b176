"""`python -m benchmarks.planning`: plans of a wheelchair in floor plans of real buildings, and times beside peers.

Goals are drawn at random where the chair fits, in the largest part of the floor that is joined for its inscribed
circle. Whether a chair of that length can go from one to another is told by nothing but the plan: a share below 1 is no
fault by itself.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from benchmarks.sequences import default_data_folder
from wheelsight.geometry import BoolArray, ByteArray, Float32Array, FloatArray
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
from wheelsight.ros_map import FREE, OCCUPIED, read_ros_map

CHAIR = Footprint.rectangle(front_m=0.8, back_m=0.3, width_m=0.6)
BARE_RESOLUTION_M = 0.05
PLANS = (
    *("Freiburg79_scan.png", "lab_ipa.png", "office_b.png", "basement_fixed.map.yaml"),
    *("ctrl_room.yaml", "indoor.yaml", "map_real.yaml", "willow-2010-02-18-0.10.yaml"),
)
_SIDE, _REPEATS, _GOALS, _SEED = 1000, 5, 20, 1


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


def told(name: str, asked: Sequence[Asked]) -> str:
    """A line about the plans of a building."""
    found = [(one, one.answer) for one in asked if isinstance(one.answer, Plan)]
    why = Counter(one.answer.reason.name for one in asked if isinstance(one.answer, PlanFailure))
    seconds = np.array([one.seconds for one in asked])
    searched = sum(plan.states > 0 for _, plan in found)
    clear = min((plan.least_clearance_m for _, plan in found), default=np.nan)
    length = sum(plan.length_m for _, plan in found)
    backward = sum(_backward_m(plan) for _, plan in found)
    ratio = np.mean([min(one.shortest_m / max(plan.length_m, 1e-9), 1.0) for one, plan in found])
    return (
        f"{name:28s} {len(found):2d} of {len(asked)} found ({searched} by search), {length:6.0f} m, "
        f"{backward:4.1f} m of it backward, least clearance {clear:.3f} m, shortest over ours {ratio:.3f}; "
        f"median {np.median(seconds):.2f} s, most {seconds.max():.2f} s {dict(why) or ''}"
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


def time_cost_to_go() -> None:
    """Print seconds for 1000 × 1000 cells, ours and peers', in alternation."""
    rng = np.random.default_rng(_SEED)
    metre_cost = (1 + 2 * rng.random((_SIDE, _SIDE))).astype(np.float32)
    metre_cost[rng.random(metre_cost.shape) < 0.1] = np.inf
    metre_cost[_SIDE // 2, _SIDE // 2] = 1
    cost_to_go(metre_cost[:50, :50].copy(), 1.0, (25, 25))
    graph = graph_of(metre_cost)
    kept: dict[str, list[float]] = {
        "ours": [],
        "csgraph's Dijkstra, its graph being made": [],
        "scikit-image's MCP": [],
    }
    for _ in range(_REPEATS):
        for name, seconds in (
            ("ours", _timed_ours(metre_cost)),
            ("csgraph's Dijkstra, its graph being made", _timed_csgraph(graph)),
            ("scikit-image's MCP", _timed_skimage(metre_cost)),
        ):
            kept[name].append(seconds)
    ours_s = float(np.median(kept["ours"]))
    for name, times in kept.items():
        median_s = float(np.median(times))
        print(f"{name}: {1000 * median_s:.0f} ms ({median_s / ours_s:.1f} times ours)")


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


def main(words: Sequence[str] | None = None) -> int:
    """Print all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=_GOALS, help="a building")
    parser.add_argument("--seed", type=int, default=_SEED)
    parser.add_argument("--only", default="", help="buildings whose names hold this")
    parser.add_argument("--pictures", type=Path, help="a folder for a picture of each building")
    arguments = parser.parse_args(words)
    time_cost_to_go()
    for name in PLANS:
        path = default_data_folder() / "maps" / name
        if arguments.only not in name:
            continue
        if not path.exists():
            print(f"{name}: left out, {path} is not there")
            continue
        grid = grid_of(path)
        asked = list(asked_in(grid, arguments.goals, arguments.seed))
        print(told(name, asked), flush=True)
        if arguments.pictures is not None:
            import cv2

            arguments.pictures.mkdir(parents=True, exist_ok=True)
            image = picture_of(grid, asked)
            cv2.imwrite(str(arguments.pictures / f"{path.stem}.png"), image[..., ::-1])
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
