"""Builds a drive to goals in a known map, or an exploration, from robot, localization and navigator. Reads a recorded
path that a robot follows again.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from wheelsight.app.run.drive_record import DriveRecord, DriveRecorder, GoalRecord
from wheelsight.app.run.loops import CORRECTED_FILE
from wheelsight.app.run.maps import open_known
from wheelsight.app.run.runs import TRAJECTORY_FILE
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, ConfigError, MapError, TrajectoryError, WheelsightError
from wheelsight.core.estimates import Estimate
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, VelocityCommand, WheelTicks, YawRate
from wheelsight.core.robots import LimitedVelocity, Localization, Robot, RobotLimits, WatchedRobot
from wheelsight.core.trajectory import read_tum
from wheelsight.estimation import Localizer, LocalizerApart, LocalizerBeside, LocalizerInStep
from wheelsight.estimation.localizer_workers import Make
from wheelsight.io.recordings import RecordingWriter, express_for
from wheelsight.mapping import OccupancyGrid
from wheelsight.navigation import (
    Controller,
    DepthViewer,
    Feedback,
    GrowingFloor,
    KnownFloor,
    NavigationReason,
    NavigationResult,
    Navigator,
    PathPlanner,
    PlanningResult,
    SeenFloor,
    Transition,
    Worker,
    WorkerBeside,
    WorkerInStep,
)
from wheelsight.navigation.planning import PLANNING_S, words_of
from wheelsight.slam.maps import DRIVE, MAP_FOLDER, MapFolder, MapWriter, driven_way, find_map, occupancy_of
from wheelsight.slam.maps.contents import current_edits
from wheelsight.slam.settings import FROM_KEYFRAMES

# How long a robot that was stopped is stepped on, until it stands.
_STOPPING_S = 5.0
# Simulated duration of a floor after 300 keyframes moved; 1000 take 1.0 s (docs/occupancy.md).
_MAPPING_S = 0.3
# Folders of a run that follows several sensors.
_TRACKS = ("joined", "dense", "features", "own")

OnStep = Callable[[Feedback], None]
OnEvents = Callable[[Sequence[Event]], None]


@dataclass(frozen=True, slots=True, eq=False)
class NamedGoal:
    """A goal: pose (3,) of x, y, yaw in the map, where a yaw of NaN is any heading, and its name."""

    pose: FloatArray
    name: str

    @classmethod
    def of(cls, pose: ArrayLike, name: str = "") -> NamedGoal:
        """A goal at x, y, yaw (3,) or x, y (2,). Without a name it is called by its coordinates."""
        at = np.array([*np.asarray(pose, float).ravel(), np.nan][:3])
        return cls(at, name or words_of(at))


class GoalDrive:
    """A drive to one goal after another in a map. `record` returns its results. `drive_in_map` makes one.

    Args:
        robot: to drive.
        recorder: gets each period.
        navigator: of the robot.
        grid: returns the current occupancy grid of the map.
        map_name: of the map.
    """

    def __init__(
        self,
        robot: Robot,
        recorder: DriveRecorder,
        navigator: Navigator,
        grid: Callable[[], OccupancyGrid],
        map_name: str,
    ) -> None:
        self.navigator, self._grid, self._map_name = navigator, grid, map_name
        self._robot, self._recorder = robot, recorder
        self._goals: list[GoalRecord] = []
        self._start: FloatArray | None = None

    @property
    def grid(self) -> OccupancyGrid:
        """The current occupancy grid of the map."""
        return self._grid()

    @property
    def start(self) -> FloatArray | None:
        """(3,) the first known pose in the map; None before it."""
        return self._start

    def refuse(self, goals: Sequence[NamedGoal]) -> None:
        """Check goals before the robot moves.

        Raises MapError for the first goal without free floor in the map, and ArgumentError.
        """
        for goal in goals:
            why = self.navigator.why_no_goal(goal.pose[:2] if np.isnan(goal.pose[2:]).any() else goal.pose)
            if why:
                raise MapError(f"{goal.name}: {why}", path=self._map_name, fix="map export --picture shows free floor")

    def go_to(self, goal: NamedGoal, on_step: OnStep) -> NavigationResult:
        """Drive to a pose and stop. `on_step` is called with each period's feedback; an exception in it ends the drive.

        Raises errors of the robot, and ArgumentError for an invalid goal.
        """
        pose = goal.pose[:2] if np.isnan(goal.pose[2:]).any() else goal.pose
        return self._through(goal, lambda: self.navigator.go_to_pose(pose, goal.name), on_step)

    def follow(self, way: ArrayLike, on_step: OnStep, name: str = "the end of a recorded way") -> NavigationResult:
        """Drive along a path (N, 3) of x, y, yaw in the map, metres and radians, and stop at its end.

        The robot first drives from its place to the path. `on_step` and errors are as of `go_to`.
        """
        poses = np.asarray(way, float)
        # What is no way has no end; the navigator refuses it before anything moves.
        end = poses[-1] if poses.ndim == 2 and len(poses) else np.full(3, np.nan)
        return self._through(NamedGoal(end, name), lambda: self.navigator.follow_way(way, name), on_step)

    def explore(self, on_step: OnStep) -> NavigationResult:
        """Drive until all reachable floor is seen, and stop. Raises errors of the robot."""
        return self._through(NamedGoal(np.full(3, np.nan), "explore"), self.navigator.explore, on_step)

    def _through(self, goal: NamedGoal, begin: Callable[[], None], on_step: OnStep) -> NavigationResult:
        begin_s = self._robot.now_s
        begin()
        try:
            return self.navigator.run(lambda feedback: self._step(feedback, on_step))
        except BaseException:
            # The caller gets the original error, not an error that follows from it.
            with suppress(WheelsightError):
                self._stop()
            raise
        finally:
            result, now = self.navigator.result, self.navigator.feedback
            if result is not None:
                self._goals.append(GoalRecord(goal.name, goal.pose, result, now.pose, begin_s, now.stamp_s))

    def clear_fault(self) -> None:
        """Permit driving again, as the user has checked the wheels. The goal that failed by them leaves the record."""
        self.navigator.clear_fault()
        if self._goals and self._goals[-1].result.reason is NavigationReason.DISOBEYS:
            self._goals.pop()

    def record(
        self, asked: int, robot: str, config: Config, truth: dict[str, Any], is_interrupted: bool
    ) -> DriveRecord:
        """The results so far.

        Args:
            asked: number of goals of the drive.
            robot: description of the robot.
            config: all settings.
            truth: figures of a simulator.
            is_interrupted: whether the user ended the drive.
        """
        kept = self._recorder
        return DriveRecord(
            map_name=self._map_name,
            robot=robot,
            goals=tuple(self._goals),
            asked=asked,
            rows=kept.rows,
            way=kept.way,
            plans=tuple(kept.plans),
            stops=tuple(kept.stops),
            clearance_m=kept.clearance_m,
            images=kept.images,
            people=kept.people,
            recognised=self.navigator.senses.localization.recognised,
            warnings=self.navigator.senses.warnings,
            grid=self._grid(),
            footprint=config.navigation.footprint.outline,
            config=config.to_dict(),
            truth=truth,
            is_interrupted=is_interrupted,
        )

    def _step(self, feedback: Feedback, on_step: OnStep) -> None:
        self._recorder.step(feedback, self.navigator.senses)
        if self._start is None and feedback.pose is not None:
            self._start = feedback.pose
        on_step(feedback)

    def _stop(self) -> None:
        """Stop at once, then step until the robot stands."""
        try:
            self._robot.stop()
        finally:
            self.navigator.cancel_task()
        until_s = self._robot.now_s + _STOPPING_S
        while self._robot.now_s < until_s:
            last = self.navigator.step()
            self._recorder.step(last, self.navigator.senses)
            if last.stands:
                return


@contextmanager
def drive_in_map(
    robot: Robot,
    config: Config,
    *,
    in_step: bool,
    takes_real_time: bool = False,
    planner: PathPlanner | None = None,
    controller: Controller | None = None,
    trusts_floor: bool = False,
    on_keyframe: Callable[[int, int], None] = lambda done, total: None,
    on_transition: Callable[[Transition], None] = lambda transition: None,
    on_events: OnEvents = lambda events: None,
) -> Iterator[GoalDrive]:
    """A drive that is ready to start.

    Args:
        robot: the robot to drive. The caller opens and closes it.
        config: with a known map.
        in_step: whether localization and planning finish before the robot goes on, as simulators need; else they run
            beside it.
        takes_real_time: whether a simulated robot is held to real time, so that plans need no simulated duration.
        planner, controller, trusts_floor, on_transition: see `Navigator`.
        on_keyframe: called with the number of keyframes read and their total.
        on_events: called with the sensors' events of each period.

    Raises:
        ConfigError: no known map is named.
        MapError, CalibrationError, ArgumentError: as `open_known` and `Navigator`.
    """
    calibration, outline = robot.calibration, config.navigation.footprint.outline
    watched, recorder = watched_of(robot), DriveRecorder(outline, config.navigation.limits)
    how: dict[str, Any] = {"planner": planner, "controller": controller}
    how |= {"trusts_floor": trusts_floor, "on_transition": on_transition}
    path = known_map_path(config)
    with (
        localization_of(known_localizer, calibration, config, in_step=in_step) as localization,
        closing(MapFolder.open(path, settings=config.sessions)) as folder,
        closing(planning_worker(in_step=in_step, takes_real_time=takes_real_time)) as planning,
        watched.watched_by(recorder.add, on_events),
    ):
        grid = occupancy_of(folder, on_keyframe=on_keyframe)
        near_m = near_floor_m(calibration, config) if trusts_floor else 0.0
        poses, driven = folder.store.T_map_keyframe, driven_way(folder)
        floor = KnownFloor(grid, current_edits(folder), poses, driven, outline, near_m)
        navigator = Navigator(watched, localization, floor, config.navigation, planning=planning, **how)
        # The name of the run's folder, if the map is in one
        map_path = folder.path.resolve()
        if map_path.name == MAP_FOLDER:
            map_path = map_path.parent
            map_path = map_path.parent if map_path.name in _TRACKS else map_path
        name_of = map_path.name or str(map_path)
        yield GoalDrive(watched, recorder, navigator, lambda: grid, name_of)


def watched_of(robot: Robot) -> WatchedRobot:
    """The robot itself if it is watched already, so that a command passes one wrapper; else a wrapper of it."""
    return robot if isinstance(robot, WatchedRobot) else WatchedRobot(robot)


WHEELS_FOLDER = "wheels"
"""The folder of a drive's results with its commands and wheel readings, a recording of wheels alone."""


_RAMP_STEP_S = 0.01


@contextmanager
def wheels_recorded(robot: Robot, out: StrPath, limits: RobotLimits) -> Iterator[Robot]:
    """The robot, whose commands and wheel readings are written to `out`/wheels within the block.

    `wheelsight calibrate drive` reads them. Commands are written as the robot limits them, in steps of 10 ms where they
    change: these the drive answers. A robot without two driven wheels is not recorded.

    Raises OutputError.
    """
    wheels = robot.calibration.wheels
    if wheels is None:
        yield robot
        return
    watched, limited, last = watched_of(robot), LimitedVelocity(limits), list[VelocityCommand]()
    calibration = Calibration(wheels=wheels, gyro=robot.calibration.gyro, source=robot.calibration.source)
    with RecordingWriter(Path(out) / WHEELS_FOLDER, calibration, force=True) as writer:

        def write(events: Sequence[Event]) -> None:
            for step in range(max(round((watched.now_s - watched.command_s) / _RAMP_STEP_S), 1)):
                given = limited.towards(watched.command, _RAMP_STEP_S)
                if last != [given]:
                    writer.add_command(watched.command_s + step * _RAMP_STEP_S, given)
                    last[:] = [given]
            for event in events:
                if isinstance(event, WheelTicks | YawRate):
                    writer.add(event)

        with watched.watched_by(write):
            yield watched


def planning_worker(*, in_step: bool, takes_real_time: bool) -> Worker[PlanningResult]:
    """The worker that plans paths. The caller closes it."""
    return WorkerInStep(0.0 if takes_real_time else PLANNING_S) if in_step else WorkerBeside("planning")


def near_floor_m(calibration: Calibration, config: Config) -> float:
    """Distance from the axle to the nearest floor that the camera sees, metres."""
    s = config.navigation
    return DepthViewer(calibration, s.footprint.outline, s.live).near_m


@contextmanager
def localization_of(
    make: Make, *arguments: Any, in_step: bool, keeps_keyframes: bool = False
) -> Iterator[Localization]:
    """A localization, ready to answer in the block.

    Args:
        make: makes the localizer from the arguments and `waits`; see `LocalizerApart`.
        arguments: of `make`.
        in_step: whether it answers before the robot goes on.
        keeps_keyframes: see `LocalizerApart`.

    Raises errors of `make`, and DeviceError if the localizer's process dies.
    """
    if in_step:
        with make(*arguments, waits=True) as answering:
            yield LocalizerInStep(answering)
        return
    apart = LocalizerApart(make, *arguments, keeps_keyframes=keeps_keyframes)
    with closing(LocalizerBeside(apart)) as beside:
        yield beside


def known_map_path(config: Config) -> Path:
    """The folder of the known map. Raises ConfigError without one, and MapError for an invalid one."""
    if config.known_map.path is None:
        raise ConfigError("there is no map to drive in", fix="--map DIR, of a run with --map surfels")
    return find_map(config.known_map.path)


@contextmanager
def known_localizer(calibration: Calibration, config: Config, *, waits: bool = False) -> Iterator[Localizer]:
    """A localizer in the known map. Raises as `open_known`, and ConfigError without a known map."""
    known_map_path(config)
    opened = open_known(calibration, config)
    assert opened is not None
    known, folder = opened
    with closing(folder), closing(Localizer(calibration, config, known=known, waits=waits)) as localizer:
        yield localizer


class MappingLocalizer:
    """A localizer whose keyframes are written to a map as they come.

    Args:
        localizer: that closes loops by keyframes.
        writer: of the map; closed with the localizer, once all loops are known.
    """

    def __init__(self, localizer: Localizer, writer: MapWriter) -> None:
        self._localizer, self._writer = localizer, writer
        self._is_closed = False

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Of the localizer."""
        return self._localizer.keyframes

    @property
    def recognised(self) -> int | None:
        """Of the localizer."""
        return self._localizer.recognised

    @property
    def warnings(self) -> tuple[str, ...]:
        """Of the localizer."""
        return self._localizer.warnings

    def process(self, event: Event) -> Estimate | None:
        """As `Localizer.process`."""
        answer = self._localizer.process(event)
        if isinstance(event, RgbdFrame):
            self._writer.update(answer)
        return answer

    def close(self) -> None:
        """Judge all loops once more, and write what is left of the map; may be called twice."""
        if self._is_closed:
            return
        self._is_closed = True
        loops = self._localizer.loops
        assert loops is not None
        try:
            closed = loops.finish()
            self._writer.add_edges(closed.edges)
        finally:
            self._writer.close(self._localizer.map, loops.recognizer)
            self._localizer.close()


@contextmanager
def mapping_localizer(
    calibration: Calibration, config: Config, path: StrPath, *, waits: bool = False
) -> Iterator[MappingLocalizer]:
    """Of a map that begins, in a folder. Raises OutputError, MapError and CalibrationError."""
    localizer = Localizer(calibration, config, waits=waits)
    store = localizer.keyframes
    assert store is not None
    folder = MapFolder.create(path, calibration, config.sessions, source="an exploration", unfinished=DRIVE)
    with closing(MappingLocalizer(localizer, MapWriter(folder, store, config.recognition))) as mapping:
        yield mapping


@contextmanager
def exploring(
    robot: Robot,
    config: Config,
    path: StrPath,
    *,
    in_step: bool,
    takes_real_time: bool = False,
    planner: PathPlanner | None = None,
    controller: Controller | None = None,
    trusts_floor: bool = False,
    on_transition: Callable[[Transition], None] = lambda transition: None,
    on_events: OnEvents = lambda events: None,
) -> Iterator[GoalDrive]:
    """A drive that can begin to explore; however it ends, what was seen is a map.

    Args:
        robot: the robot to drive. The caller opens and closes it.
        config: with loops by keyframes, and no known map.
        path: folder of the map, empty or not there.
        in_step: whether localization, map and plans answer before the robot goes on, as for simulators; else beside it.
        takes_real_time, planner, controller, trusts_floor, on_transition, on_events: see `drive_in_map`.

    Raises:
        ConfigError: loops are not closed, or a known map is named.
        OutputError, MapError, CalibrationError, ArgumentError: as `MapFolder.create` and `Navigator`.
    """
    if config.known_map.path is not None:
        raise ConfigError("an exploration begins without a map", fix="no --map, or --to a place of it")
    if config.loops.source != FROM_KEYFRAMES:
        raise ConfigError("an exploration closes loops", fix='load_config(overrides={"loops.source": "keyframes"})')
    footprint, calibration = config.navigation.footprint.outline, robot.calibration
    near_m = near_floor_m(calibration, config) if trusts_floor else 0.0
    watched, recorder = watched_of(robot), DriveRecorder(footprint, config.navigation.limits)
    how: dict[str, Any] = {"planner": planner, "controller": controller}
    how |= {"trusts_floor": trusts_floor, "on_transition": on_transition}
    mapping_s = 0.0 if takes_real_time else _MAPPING_S
    worker: Worker[SeenFloor] = WorkerInStep(mapping_s) if in_step else WorkerBeside("floor")
    # The localization is closed last: others look at its keyframes.
    with (
        localization_of(
            mapping_localizer, calibration, config, Path(path), in_step=in_step, keeps_keyframes=True
        ) as localization,
        closing(worker) as growing,
        closing(planning_worker(in_step=in_step, takes_real_time=takes_real_time)) as planning,
        watched.watched_by(recorder.add, on_events),
    ):
        floor = GrowingFloor(localization, calibration, footprint, near_m, config.sessions.occupancy, worker=growing)
        navigator = Navigator(watched, localization, floor, config.navigation, planning=planning, **how)
        yield GoalDrive(watched, recorder, navigator, lambda: floor.grid, Path(path).parent.name or Path(path).name)


def loops_of(path: StrPath) -> int:
    """How many loops a map has, once its exploration is over. Raises MapError."""
    with closing(MapFolder.open(path)) as folder:
        return sum(edge.is_loop for edge in folder.edges)


_log = logging.getLogger(__name__)

# Where a run has its trajectory, and first the file that knows more: loops have corrected it.
_RECORDED_WAYS_TRACKS = ("", "joined", "dense", "features", "own")
_FILES = (CORRECTED_FILE, TRAJECTORY_FILE)
# A base that is tipped farther drives on no floor: the poses are of a camera, or of another frame.
_MOST_TIPPED_DEG = 30.0


def read_way(path: StrPath, calibration: Calibration, warn: Callable[[str], None] = _log.warning) -> FloatArray:
    """(N, 3) x, y, yaw of the base in the map, metres and radians, in the order of the drive.

    Args:
        path: TUM text, such as the trajectory.txt of a run or of a drive; or the folder of one of these. Without frames
            in its header, poses are of the base in the map.
        calibration: of the robot; poses of its camera are converted to poses of its base.
        warn: called with one sentence about poses that were left out.

    Raises:
        TrajectoryError: no such file, no poses, a value that is not finite (with its line), poses in another frame than
            the map, or of a base that is tipped over.
        CalibrationError: the poses are of the camera, and the calibration has no mount.
    """
    file = Path(path)
    if os.path.isdir(file):  # noqa: PTH112 (a name that is too long is none)
        # The trajectory in a run's folder
        within = [file / track / name for track in _RECORDED_WAYS_TRACKS for name in _FILES]
        in_folder = next((one for one in within if one.is_file()), None)
        if in_folder is None:
            problem = f"the folder holds neither {TRAJECTORY_FILE} nor {CORRECTED_FILE}"
            raise TrajectoryError(problem, path=file, fix="give a trajectory, or the folder of a run or a drive")
        file = in_folder
    found = read_tum(file, "base", warn)
    if found.frame != "map":
        problem = f"the field frames says that its poses are in {found.frame}, not in the map"
        raise TrajectoryError(problem, path=file, fix=f"give {TRAJECTORY_FILE} or {CORRECTED_FILE} of a run in the map")
    try:
        of_base = express_for("base", found, calibration)
    except CalibrationError as error:
        problem = f"its poses are of the {found.body}, and the map's calibration has no T_base_camera"
        raise CalibrationError(problem, path=file, fix="give a way of the base, as wheelsight drive writes") from error
    # The base must stand upright in the map.
    tipped_deg = np.degrees(np.arccos(np.clip(of_base.T_frame_body[:, 2, 2], -1.0, 1.0)))
    for bad in np.flatnonzero(tipped_deg > _MOST_TIPPED_DEG):
        tipped_problem = f"the quaternion at stamp {of_base.stamps_s[bad]:.6f} tips the base by {tipped_deg[bad]:.0f}°"
        raise TrajectoryError(tipped_problem, path=file, fix="give poses of the base in the map, whose z points up")
    T = of_base.T_frame_body
    return np.column_stack([T[:, :2, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])])
