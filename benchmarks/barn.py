"""`python -m benchmarks.barn`: a robot crosses the real fields of the BARN challenge, without a map.

The fields are those of the challenge (../shared/data/barn). "jackal" is the challenge's robot, 0.51 × 0.43 m and 2
m/s, in fields as they are. "wheelchair" is the chair of 1.10 × 0.60 m and 1 m/s, in fields that are 1.75 times as
large. Both have a depth camera of 87° × 58°; "wheelchair-kinect" has the chair's usual one of 57° × 44°, which sees the
floor from 2.3 m on. They have the simulator's real sensors (`realism="real"`), their own localization, and the
navigation of `wheelsight drive`, to which unknown floor costs more but is not forbidden. They know nothing but how far
on the goal is. Each field is tried once. With `--rays` poses are known, depth is by rays with the camera's noise, and
wheels do not slip.

"Crossed" is to come within 1 m of the goal (1.75 m in larger fields), by the truth, without having touched anything, in
the challenge's 100 s (175 s in larger fields). Time counts from the begin; simulated time stands still while the
program computes. The score is the challenge's since 2025: crossed · OT / clip(AT, 2 OT, 8 OT), where AT is the time
taken, and OT the length of the reference path from start to goal over 2 m/s; at most 0.5. "By own speed" has the
robot's top speed in place of 2 m/s.

`--pictures DIR` draws each way, coloured by speed. The second table has the time of all drives by what the robot did.
"""

from __future__ import annotations

import argparse
import io
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.console import Console

from benchmarks import machine
from benchmarks.barn_worlds import HEIGHT_M, RADIUS_M, ROBOTS, Field, FieldRobot, numbers_in, read_field
from benchmarks.kept_records import KeptRecords
from benchmarks.navigation_page import write_section
from benchmarks.plain_rooms import DepthEye, Pillars, RoomRobot, TrueLocalization
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import WheelsightError
from wheelsight.core.files import write_bytes
from wheelsight.core.geometry import FloatArray
from wheelsight.core.robots import Localization, Robot
from wheelsight.estimation import Localizer, LocalizerInStep
from wheelsight.navigation import Feedback, Footprint, GrowingFloor, NavigationState, Navigator, planar_pose
from wheelsight_sim import SimulationSettings, Simulator, camera_model

CROSSED_PERCENT, SCORE = 97.0, 0.45
GOAL_M, PUBLISHED_M_S = 1.0, 2.0
NEWER, SLOWEST = 2.0, 8.0
_TITLE = "Fields of the BARN challenge"
_PUBLISHED = (
    ("DWA on a Jackal with a lidar (published: the challenge's README)", "500", "88.0 %", "4.8 %", "0.169", "—", "34"),
    ("best of 2026 in simulation, with a lidar (published: its report)", "500", "—", "—", "0.498", "—", "—"),
)
_HEADER = ("robot", "fields", "crossed", "touched", "score", "by own speed", "s")
# Share of the top speed from which on a robot counts as fast; and speeds below which it stands, or turns in place.
_FAST_SHARE, _STANDS_M_S, _TURNS_RAD_S = 0.8, 0.05, 0.1


@dataclass(frozen=True)
class Crossing:
    """Outcome of a field.

    Attributes:
        robot, number: who crossed which field.
        best_m: length of the reference path.
        time_s, way_m: taken and driven.
        off_m: least distance to the goal.
        contacts: what was touched.
        clearance_m: least true distance to things.
        ended: why it was over, in words.
        spent_s: seconds by what the robot did.
    """

    robot: str
    number: int
    best_m: float
    time_s: float
    way_m: float
    off_m: float
    contacts: tuple[str, ...]
    clearance_m: float
    ended: str
    spent_s: dict[str, float]

    @property
    def is_success(self) -> bool:
        """At the goal in time, with nothing touched."""
        by = ROBOTS[self.robot]
        return self.off_m <= GOAL_M * by.scale and self.time_s <= by.longest_s and not self.contacts

    def score(self, top_m_s: float = PUBLISHED_M_S) -> float:
        """Of the challenge, by a speed."""
        optimal_s = self.best_m / top_m_s
        taken_s = min(max(self.time_s, NEWER * optimal_s), SLOWEST * optimal_s)
        return optimal_s / taken_s if self.is_success else 0.0

    @property
    def own_score(self) -> float:
        """The same by the robot's top speed."""
        return self.score(ROBOTS[self.robot].settings.limits.forward_m_s)

    @property
    def sentence(self) -> str:
        """For the terminal."""
        what = "crossed" if self.is_success else f"{self.ended}, {self.off_m:.1f} m from the goal"
        touched = f", touched {', '.join(self.contacts)}" if self.contacts else ""
        return (
            f"{self.robot}, field {self.number}: {what} after {self.time_s:.0f} s, {self.way_m:.1f} m for"
            f" {self.best_m:.1f}, clearance {self.clearance_m:.2f} m{touched}"
        )


class _Truth(Protocol):
    """A robot's true state."""

    @property
    def now_s(self) -> float:
        """Seconds since the start."""

    @property
    def pose(self) -> FloatArray:
        """(3,) x, y, yaw."""

    @property
    def clearance_m(self) -> float:
        """Distance from its outline to the nearest thing."""

    @property
    def touched(self) -> tuple[str, ...]:
        """Names of what it drove into."""


class _Simulated(Simulator):
    """A simulated robot, of any sizes, whose owner knows its camera's nominal mount."""

    @property
    def calibration(self) -> Calibration:
        return replace(super().calibration, T_base_camera=self.settings.robot.T_base_camera)

    @property
    def truth(self) -> _Truth:
        return _SimulatedTruth(self)


@dataclass(frozen=True)
class _SimulatedTruth:
    robot: Simulator

    @property
    def now_s(self) -> float:
        return self.robot.time_s

    @property
    def pose(self) -> FloatArray:
        return planar_pose(self.robot.T_world_base)

    @property
    def clearance_m(self) -> float:
        return self.robot.clearance_m()

    @property
    def touched(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.robot.contacts if one.is_by_robot)


@dataclass(frozen=True)
class _RayTruth:
    robot: RoomRobot
    footprint: Footprint

    @property
    def now_s(self) -> float:
        return self.robot.now_s

    @property
    def pose(self) -> FloatArray:
        return self.robot.base.pose

    @property
    def clearance_m(self) -> float:
        return self.robot.walls.clearance_m(self.footprint.at(self.pose))

    @property
    def touched(self) -> tuple[str, ...]:
        return ("a cylinder",) if self.clearance_m <= 0 else ()


@dataclass(frozen=True)
class Images:
    """Size of the images in pixels, and how many come a second."""

    size: tuple[int, int] = (160, 120)
    rate_hz: float = 10.0


def crossed(field: Field, by: FieldRobot, seed: int, images: Images, picture: Path | None = None) -> Crossing:
    """Drive through a field, as the simulator has it."""
    how = SimulationSettings(
        camera=by.camera,
        size=images.size,
        rate_hz=images.rate_hz,
        seed=seed,
        day=1 + field.number,
        realism="real",
        robot=by.model,
    )
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    with _Simulated(how, world=field.world, start=(0.0, 0.0, 0.0), limits=by.settings.limits) as simulator:
        localization = LocalizerInStep(Localizer(simulator.calibration, config, waits=True))
        try:
            return _driven(field, by, simulator, localization, simulator.truth, picture)
        finally:
            localization.close()


# Of `crossed_by_rays`: the size of depth images, how far they reach, and the spread of edges in pixels.
_RAY_SIZE, _RAYS_TO_M, _RAYS_EDGE_PX = (96, 72), 8.0, 0.4


def crossed_by_rays(field: Field, by: FieldRobot, seed: int, picture: Path | None = None) -> Crossing:
    """Drive through a field with known poses, depth by rays with the camera's noise, and wheels without slip."""
    model, footprint = camera_model(by.camera, _RAY_SIZE), by.settings.footprint.outline
    senses_m = model.depth_noise.near_m, _RAYS_TO_M
    eye = DepthEye(model.camera, by.model.T_base_camera, senses_m, model.depth_noise, _RAYS_EDGE_PX)
    pillars = Pillars(field.pillars_m, RADIUS_M * field.scale, HEIGHT_M)
    robot = RoomRobot(pillars, (0.0, 0.0, 0.0), eye, by.settings.limits, seed + field.number)
    localization = TrueLocalization(robot)
    try:
        return _driven(field, by, robot, localization, _RayTruth(robot, footprint), picture)
    finally:
        localization.close()


def _driven(
    field: Field, by: FieldRobot, robot: Robot, localization: Localization, truth: _Truth, picture: Path | None
) -> Crossing:
    """Drive until it is over."""
    footprint, goal = by.settings.footprint.outline, field.goal_m
    floor = GrowingFloor(localization, robot.calibration, footprint, by.scale, holds=[goal])
    navigator = Navigator(robot, localization, floor, by.settings, trusts_floor=True)
    driven, spent_s, last_s = list[FloatArray](), dict[str, float](), truth.now_s
    off_m, clearance_m, ended = np.inf, np.inf, ""
    navigator.go_to_pose(goal)
    while not ended:
        feedback = navigator.step()
        driven.append(np.append(truth.pose, feedback.forward_m_s))
        off_m = min(off_m, float(np.hypot(*(truth.pose[:2] - goal))))
        clearance_m = min(clearance_m, truth.clearance_m)
        doing = doing_of(feedback, by.settings.limits.forward_m_s)
        spent_s[doing] = spent_s.get(doing, 0.0) + truth.now_s - last_s
        last_s = truth.now_s
        ended = _why_over(by, truth, navigator, off_m)
    way = np.array(driven)
    found = Crossing(
        by.name,
        field.number,
        field.best_m,
        truth.now_s,
        float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum()),
        off_m,
        truth.touched,
        clearance_m,
        ended,
        {doing: round(seconds, 3) for doing, seconds in sorted(spent_s.items(), key=lambda one: -one[1])},
    )
    if picture is not None:
        _draw(field, by, way, found, picture)
    return found


def _why_over(by: FieldRobot, truth: _Truth, navigator: Navigator, off_m: float) -> str:
    """In words; empty while it goes on. As in the challenge, a contact ends the drive."""
    if truth.touched:
        return "a contact"
    if off_m <= GOAL_M * by.scale:
        return "at the goal"
    if navigator.is_task_complete():
        return "gave up" if navigator.result is None else f"gave up: {navigator.result.detail}"
    return "took too long" if truth.now_s > by.longest_s else ""


def doing_of(feedback: Feedback, top_m_s: float) -> str:
    """What a robot does in a period, in words."""
    if feedback.state is not NavigationState.DRIVING:
        return {NavigationState.PLANNING: "waits for a plan"}.get(feedback.state, f"{feedback.state}: {feedback.doing}")
    if feedback.monitor is not None and feedback.monitor.reason is not None:
        return f"monitor: {feedback.monitor.reason}"
    speed_m_s = abs(feedback.forward_m_s)
    if speed_m_s < _STANDS_M_S:
        return "turns in place" if abs(feedback.turn_rad_s) > _TURNS_RAD_S else "stands, without a hold"
    if feedback.forward_m_s < 0:
        return "drives backward"
    return "drives fast" if speed_m_s > _FAST_SHARE * top_m_s else "drives, not held"


def _draw(field: Field, by: FieldRobot, driven: FloatArray, found: Crossing, path: Path) -> None:
    """The field, the reference path, and the way driven, coloured by speed, with the outline each 2 s."""
    figure = Figure(figsize=(11, 5.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", title=f"{found.sentence}, score {found.score():.2f}")
    axes.add_collection(PatchCollection([Circle(at, RADIUS_M * by.scale) for at in field.pillars_m], color="#3d434d"))
    axes.plot(*field.path_m.T, color="#9aa3ad", lw=1, ls="--", label="reference path")
    places = driven[:, :2]
    line = LineCollection(np.stack([places[:-1], places[1:]], axis=1).tolist(), cmap="viridis", lw=2.5, zorder=3)
    line.set_array(driven[1:, 3])
    line.set_clim(0, by.settings.limits.forward_m_s)
    axes.add_collection(line)
    figure.colorbar(line, ax=axes, label="m/s", shrink=0.7)
    for pose in driven[::40]:
        corners = by.settings.footprint.outline.at(pose[:3])
        axes.fill(*corners.T, fill=False, ec="#c2185b", lw=0.6)
    axes.add_patch(Circle(tuple(field.goal_m.tolist()), GOAL_M * by.scale, fill=False, color="#4e9a51"))
    axes.autoscale_view()
    figure.text(0.01, 0.01, "; ".join(f"{doing} {s:.0f} s" for doing, s in found.spent_s.items() if s >= 1), fontsize=7)
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    write_bytes(path, stream.getvalue())


def row_of(name: str, crossings: Sequence[Crossing]) -> tuple[str, ...]:
    """Of the table."""
    count, done = len(crossings), [one for one in crossings if one.is_success]
    return (
        name,
        str(count),
        f"{100 * len(done) / count:.1f} %",
        f"{100 * sum(bool(one.contacts) for one in crossings) / count:.1f} %",
        f"{statistics.mean(one.score() for one in crossings):.3f}",
        f"{statistics.mean(one.own_score for one in crossings):.3f}",
        f"{statistics.mean(one.time_s for one in done):.0f}" if done else "—",
    )


def _percent(crossings: Sequence[Crossing], doing: str) -> str:
    spent_s = sum(one.spent_s.get(doing, 0.0) for one in crossings)
    return f"{100 * spent_s / sum(sum(one.spent_s.values()) for one in crossings):.1f} %"


def sheets_of(crossings: Sequence[Crossing]) -> list[Sheet]:
    """Each robot, what others have published, where time goes, and what must be reached."""
    by_robot = {name: [one for one in crossings if one.robot == name] for name in ROBOTS}
    by_robot = {name: some for name, some in by_robot.items() if some}
    rows, targets = [row_of(name, some) for name, some in by_robot.items()], list[Target]()
    for name, some in by_robot.items():
        share = 100 * sum(one.is_success for one in some) / len(some)
        score, touched = statistics.mean(one.score() for one in some), sum(bool(one.contacts) for one in some)
        targets += [
            Target(f"{name}: crossed, of {len(some)} fields", CROSSED_PERCENT, share, "%", is_least=True),
            Target(f"{name}: fields in which something was touched", 0, touched, "", 0),
            Target(f"{name}: score, of 0.50", SCORE, score, "", 3, is_least=True),
        ]
    doings: dict[str, float] = {}
    for one in crossings:
        for doing, seconds in one.spent_s.items():
            doings[doing] = doings.get(doing, 0.0) + seconds
    longest = sorted(doings, key=lambda doing: -doings[doing])
    shares = [(doing, *(_percent(some, doing) for some in by_robot.values())) for doing in longest]
    sheets = [
        Sheet("Crossings", _HEADER, (*rows, *_PUBLISHED)),
        Sheet("Time by what the robot did", ("doing", *by_robot), tuple(shares)),
        targets_sheet(targets),
    ]
    missed = tuple((one.sentence,) for one in crossings if not one.is_success)
    return [*sheets, Sheet("Fields that were not crossed", ("field",), missed)] if missed else sheets


def _size(word: str) -> tuple[int, int]:
    width, height = map(int, word.split("x"))
    return width, height


def _parser() -> argparse.ArgumentParser:
    example = "python -m benchmarks.barn --robots wheelchair --every 15 --keep kept/barn --pictures ways"
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.barn",
        description=__doc__,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    usual = [*ROBOTS][:2]
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the fields, world_NNN.csv")
    parser.add_argument("--robots", nargs="+", choices=[*ROBOTS], default=usual, help="default: the first two")
    parser.add_argument("--rays", action="store_true", help="quick: known poses, depth by rays, no physics")
    parser.add_argument("--fields", nargs="+", type=int, metavar="N", help="their numbers; default: all of the folder")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="only each Nth of the fields")
    parser.add_argument("--seed", type=int, default=1, help="of all that is random about the robot")
    parser.add_argument("--size", type=_size, default="160x120", metavar="WxH", help="of the images")
    parser.add_argument("--rate", type=float, default=10.0, help="images a second")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draws each way")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps drives; those kept are not measured again")
    return parser


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = _parser()
    asked = parser.parse_args()
    if asked.every < 1:
        parser.error(f"argument --every: {asked.every} is less than 1")
    folder, images = asked.data or default_data_folder() / "barn", Images(asked.size, asked.rate)
    size = "x".join(map(str, asked.size))
    by_what = {"rays": True} if asked.rays else {"rate_hz": asked.rate, "size": size}
    kept = KeptRecords(asked.keep, {"seed": asked.seed, **by_what})
    what = f"--seed {asked.seed} " + ("--rays" if asked.rays else f"--size {size} --rate {asked.rate:g}")
    what += f" --every {asked.every}" if asked.fields is None else " --fields " + " ".join(map(str, asked.fields))
    about = machine.description() | {
        "Command": f"`python -m benchmarks.barn --robots {' '.join(asked.robots)} {what}`",
        "Images": "depth by rays" if asked.rays else f"{size}, {asked.rate:g} a second",
    }

    def cross(name: str, number: int) -> Crossing:
        by, picture = ROBOTS[name], None
        record = kept.of(f"{name}-{number}")
        if record is None:
            if asked.pictures is not None:
                asked.pictures.mkdir(parents=True, exist_ok=True)
                picture = asked.pictures / f"{name}-{number}.png"
            field = read_field(folder, number, by.scale)
            if asked.rays:
                record = asdict(crossed_by_rays(field, by, asked.seed, picture))
            else:
                record = asdict(crossed(field, by, asked.seed, images, picture))
            kept.keep(f"{name}-{number}", record)
        return Crossing(**{**record, "contacts": tuple(record["contacts"])})

    console, crossings = Console(width=150), list[Crossing]()
    try:
        numbers = list(asked.fields or numbers_in(folder))[:: asked.every]
        for name, number in product(asked.robots, numbers):
            crossings.append(cross(name, number))
            console.print(f"{crossings[-1].sentence}, score {crossings[-1].score():.2f}")
            if asked.out is not None:  # now, since hours of drives may be broken off
                write_section(asked.out, _TITLE, __doc__ or "", about, sheets_of(crossings))
    except WheelsightError as error:
        parser.error(str(error))
    for sheet in sheets_of(crossings):
        console.print(sheet.to_rich())


if __name__ == "__main__":
    main()
