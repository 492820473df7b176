"""`python -m benchmarks.doors`: a wheelchair passes doors of a map that it made itself.

A wall of 0.12 m with one door stands in a room of 10 × 8 m, in any direction against the cells of the map. On the first
day the robot is led through the door, once each way, and makes the map by depth of a Kinect (rays with its noise; 57° ×
44°, 160×120, a keyframe every 0.25 m) at poses with a random error of 5 mm and 0.1°. On the second day it begins
2.2 m before the door, aside by up to 40°, and looks at it; its goal is 2 m beyond. Its pose in the map has a constant
error of up to 15 mm and 0.3°. Planner, controller and collision monitor are those of `wheelsight drive`. There are no
images, no physics and no localization, so a drive takes seconds.

"Passed" is to have all of the outline beyond the wall within 15 s, with nothing touched. "In the map" is the widest
straight way through the door between the squares of occupied cells, less the door's width. Where a wall is oblique, its
squares stick out: cells of 0.05 m whose middles lie in the true wall leave a door 0.036 m too narrow on average.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.navigation_page import write_section
from benchmarks.plain_rooms import DepthEye, RoomRobot, TrueLocalization, Walls
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.mapping import CellKind, OccupancyGrid, OccupancyMapper
from wheelsight.navigation import KnownFloor, NavigationSettings, Navigator, Transition
from wheelsight_sim import RobotModel, camera_model

WIDTHS_M, PASS_S = (0.75, 0.80, 0.90, 1.00), 15.0
LEAST_PERCENT = {0.75: 80.0, 0.80: 95.0}
_TITLE = "Doors of a map that the robot made"
_THICK_M, _ROOM_M = 0.12, (5.0, 4.0)
_BEFORE_M, _BEYOND_M, _ASIDE_RAD = 2.2, 2.0, 0.7
_MAPPED_M, _MAPPED_RAD = 0.005, 0.002
_PLACED_M, _PLACED_RAD = 0.015, 0.005
# Half of the length along the door's normal, beside the wall, in which cells narrow the way through.
_REACH_M = 0.45


def kinect() -> DepthEye:
    """The chair's usual camera, small."""
    model = camera_model("kinect-v1", (160, 120))
    return DepthEye(model.camera, RobotModel().T_base_camera, (0.45, 8.0), model.depth_noise, 0.2)


@dataclass(frozen=True)
class Door:
    """A wall with a door. In its own frame the wall's near face is x = 0, and the door's middle y = 0.

    Attributes:
        width_m: of the door.
        yaw_rad, place_m: of its frame in that of the map.
    """

    width_m: float
    yaw_rad: float
    place_m: tuple[float, float] = (0.0, 0.0)

    def placed(self, poses: FloatArray) -> FloatArray:
        """Poses (N, 3) or places (N, 2) of its frame in that of the map."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        xy = poses[:, :2] @ np.array([[c, s], [-s, c]]) + self.place_m
        return np.column_stack([xy, poses[:, 2:] + self.yaw_rad])

    @property
    def walls(self) -> Walls:
        """Of the room, and both sides of the wall."""
        x, y = _ROOM_M
        ends = [((-x, -y), (-x, y)), ((x, -y), (x, y)), ((-x, -y), (x, -y)), ((-x, y), (x, y))]
        for half_m, far_m in ((self.width_m / 2, y), (-self.width_m / 2, -y)):
            ends += [((0.0, half_m), (0.0, far_m)), ((_THICK_M, half_m), (_THICK_M, far_m))]
            ends.append(((0.0, half_m), (_THICK_M, half_m)))
        return Walls(self.placed(np.array(ends).reshape(-1, 2)).reshape(-1, 2, 2))

    def mapped(self, aside_rad: float, rng: np.random.Generator) -> tuple[OccupancyGrid, FloatArray]:
        """The map of the first day, and poses (N, 3) driven; the robot came at an angle to the door's normal."""
        eye, ahead = kinect(), np.arange(0.0, _BEFORE_M, 0.25)
        come = (ahead[:, None] - 3.0) * [np.cos(aside_rad), np.sin(aside_rad)]
        through = np.arange(-0.8, _BEYOND_M + 0.3, 0.25)
        poses = np.concatenate(
            [
                np.column_stack([come, np.full(len(come), aside_rad)]),
                np.column_stack([through, np.zeros((len(through), 2))]),
            ]
        )
        driven = self.placed(np.concatenate([poses, poses[::-1] + [0.0, 0.0, np.pi]]))
        mapper, K, walls = OccupancyMapper(eye.calibration), eye.camera, self.walls
        for number, true in enumerate(driven):
            depth_m = eye.measured(walls.depth_m(se3.from_plane(*true) @ eye.T_base_camera, eye), rng)
            image = depth_m.astype(np.float32)
            intrinsics = np.array([K.fx, K.fy, K.cx, K.cy])
            keyframe = Keyframe.of_images(float(number), intrinsics, image, np.zeros_like(image))
            off = rng.standard_normal(3) * (_MAPPED_M, _MAPPED_M, _MAPPED_RAD)
            mapper.add(KeyframeId(number), keyframe, se3.from_plane(*(true + off)) @ eye.T_base_camera)
        return mapper.grid(), driven

    def width_in(self, grid: OccupancyGrid) -> float:
        """Of the widest straight way through the door between squares of occupied cells, metres."""
        cells = np.argwhere(grid.kind == CellKind.OBSTACLE)[:, None, ::-1] + [[0, 0], [1, 0], [0, 1], [1, 1]]
        away = cells * grid.resolution_m + grid.origin - self.place_m
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        x, y = np.moveaxis(away @ np.array([[c, -s], [s, c]]), -1, 0)
        is_near = (x.max(axis=1) > -_REACH_M) & (x.min(axis=1) < _THICK_M + _REACH_M)
        low, high = y.min(axis=1)[is_near], y.max(axis=1)[is_near]
        is_left = low + high > 0
        return float(low[is_left].min(initial=_ROOM_M[1]) - high[~is_left].max(initial=-_ROOM_M[1]))


def any_door(width_m: float, rng: np.random.Generator) -> Door:
    """A door in any direction, anywhere against the cells."""
    x, y = rng.uniform(0, 0.05, 2).tolist()
    return Door(width_m, float(rng.uniform(-np.pi, np.pi)), (x, y))


@dataclass(frozen=True)
class Passage:
    """Outcome of a door: seconds until it was passed, or None; least clearance; width in the map; and why not."""

    time_s: float | None
    clearance_m: float
    mapped_m: float
    why: str


def passed(
    width_m: float, seed: int, longest_s: float = 60.0, on_transition: Callable[[Transition], None] = lambda _: None
) -> Passage:
    """Map a door, and drive through it."""
    rng = np.random.default_rng([seed, round(1000 * width_m)])
    door = any_door(width_m, rng)
    grid, driven = door.mapped(float(rng.uniform(-_ASIDE_RAD, _ASIDE_RAD)), rng)
    aside = float(rng.uniform(-_ASIDE_RAD, _ASIDE_RAD))
    begin = np.array([[-_BEFORE_M * np.cos(aside), -_BEFORE_M * np.sin(aside), aside]])
    robot = RoomRobot(door.walls, tuple(door.placed(begin)[0].tolist()), kinect(), seed=seed, frame_periods=4)
    off = se3.from_plane(*(rng.uniform(-1, 1, 3) * (_PLACED_M, _PLACED_M, _PLACED_RAD)))

    def says(estimate: Estimate) -> Estimate:
        assert estimate.T_odom_body is not None
        return Estimate(estimate.stamp_s, estimate.status, off @ estimate.T_odom_body, estimate.covariance, body="base")

    localization = TrueLocalization(robot, None, says=says)
    why = ""

    def note(transition: Transition) -> None:
        nonlocal why
        why = str(transition)
        on_transition(transition)

    settings = NavigationSettings()
    footprint = settings.footprint.outline
    floor = KnownFloor(grid, driven=[driven[: len(driven) // 2]], footprint=footprint)
    navigator = Navigator(robot, localization, floor, settings, trusts_floor=True, on_transition=note)
    navigator.go_to_pose(door.placed(np.array([[_BEYOND_M, 0.0, 0.0]]))[0])
    clearance_m, mapped_m = np.inf, door.width_in(grid) - width_m
    ahead = door.placed(np.array([[1.0, 0.0]]))[0] - door.place_m
    while robot.now_s < longest_s and not navigator.is_task_complete():
        navigator.step()
        corners = footprint.at(robot.base.pose)
        clearance_m = min(clearance_m, robot.walls.clearance_m(corners))
        if clearance_m <= 0.002:
            return Passage(None, clearance_m, mapped_m, "touched the wall")
        if ((corners - door.place_m) @ ahead).min() > _THICK_M:
            return Passage(robot.now_s, clearance_m, mapped_m, "")
    return Passage(None, clearance_m, mapped_m, why or "took too long")


def sheets_of(found: dict[float, list[Passage]]) -> list[Sheet]:
    """Each width, and what must be reached."""
    rows, targets, missed = [], list[Target](), []
    for width_m, passages in found.items():
        times_s = [one.time_s for one in passages if one.time_s is not None]
        in_time = 100 * sum(time_s <= PASS_S for time_s in times_s) / len(passages)
        off_m = np.array([one.mapped_m for one in passages])
        touched = sum(one.clearance_m <= 0.002 for one in passages)
        rows.append(
            (
                f"{width_m:.2f}",
                str(len(passages)),
                f"{in_time:.0f} %",
                f"{100 * len(times_s) / len(passages):.0f} %",
                str(touched),
                f"{np.median(times_s):.1f}" if times_s else "—",
                f"{min(one.clearance_m for one in passages):.3f}",
                f"{off_m.mean():+.3f} ± {off_m.std():.3f}",
            )
        )
        if width_m in LEAST_PERCENT:
            words = f"{width_m:.2f} m: passed in {PASS_S:g} s, of {len(passages)}"
            targets.append(Target(words, LEAST_PERCENT[width_m], in_time, "%", is_least=True))
        targets.append(Target(f"{width_m:.2f} m: doors at which something was touched", 0, touched, "", 0))
        for one in passages:
            if one.time_s is None or one.time_s > PASS_S:
                what = one.why or f"passed after {one.time_s:.0f} s"
                missed.append((f"{width_m:.2f} m, {one.mapped_m:+.3f} m in the map: {what}",))
    header = ("door m", "doors", f"in {PASS_S:g} s", "passed", "touched", "s", "clearance m", "in the map m")
    sheets = [Sheet("Doors", header, tuple(rows)), targets_sheet(targets)]
    return [*sheets, Sheet("Doors that were not passed in time", ("door",), tuple(missed))] if missed else sheets


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.doors",
        description=__doc__,
        epilog="example: python -m benchmarks.doors --widths 0.8 --doors 20",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--widths", nargs="+", type=float, default=list(WIDTHS_M), metavar="M", help="of doors")
    parser.add_argument("--doors", type=int, default=100, help="of each width")
    parser.add_argument("--first", type=int, default=0, help="seed of the first door")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    asked = parser.parse_args()
    if asked.doors < 1 or not all(0.6 < width_m <= 2.0 for width_m in asked.widths):
        parser.error("give one door or more, over 0.6 and up to 2 m wide: the chair has 0.6 m")
    console, found = Console(width=150), dict[float, list[Passage]]()
    for width_m in asked.widths:
        found[width_m] = [passed(width_m, seed) for seed in range(asked.first, asked.first + asked.doors)]
    command = f"--widths {' '.join(map(str, asked.widths))} --doors {asked.doors} --first {asked.first}"
    about = machine.description() | {"Command": f"`python -m benchmarks.doors {command}`"}
    for sheet in sheets_of(found):
        console.print(sheet.to_rich())
    if asked.out is not None:
        write_section(asked.out, _TITLE, __doc__ or "", about, sheets_of(found))


if __name__ == "__main__":
    main()
