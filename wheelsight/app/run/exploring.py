"""An exploration: a robot drives until it has seen all reachable floor, and leaves a map for the next drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from wheelsight.app.run.drive_record import DriveRecorder
from wheelsight.app.run.drives import GoalDrive, OnEvents, WatchedRobot, localization_of, near_floor_m, planning_worker
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Estimate
from wheelsight.core.files import StrPath
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.robots import Robot
from wheelsight.estimation import Localizer
from wheelsight.navigation import GrowingFloor, Navigator, SeenFloor, Transition, Worker, WorkerBeside, WorkerInStep
from wheelsight.slam.maps import DRIVE, MapFolder, MapWriter
from wheelsight.slam.settings import FROM_KEYFRAMES


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

    def process(self, event: Event) -> Estimate | None:
        """As `Localizer.process`."""
        answer = self._localizer.process(event)
        if isinstance(event, RgbdFrame):
            self._writer.look(answer)
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
    calibration: Calibration, config: Config, path: Path, *, waits: bool = False
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
        trusts_floor, on_transition, on_events: see `drive_in_map`.

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
    how: dict[str, Any] = {"trusts_floor": trusts_floor, "on_transition": on_transition}
    mapping_s = config.navigation.navigator.mapping_s
    worker: Worker[SeenFloor] = WorkerInStep(mapping_s) if in_step else WorkerBeside("floor")
    # The localization is closed last: others look at its keyframes.
    with (
        localization_of(
            mapping_localizer, calibration, config, Path(path), in_step=in_step, tells_keyframes=True
        ) as localization,
        closing(worker) as growing,
        closing(planning_worker(config, in_step=in_step)) as planning,
    ):
        floor = GrowingFloor(localization, calibration, footprint, near_m, config.sessions.occupancy, worker=growing)
        watched = WatchedRobot(robot, DriveRecorder(footprint), on_events)
        navigator = Navigator(watched, localization, floor, config.navigation, planning=planning, **how)
        yield GoalDrive(watched, navigator, lambda: floor.grid, Path(path).parent.name or Path(path).name)


def loops_of(path: StrPath) -> int:
    """How many loops a map has, once its exploration is over. Raises MapError."""
    with closing(MapFolder.open(path)) as folder:
        return sum(edge.is_loop for edge in folder.edges)
