"""A robot in the synthetic room, whose camera shows it, and a localizer that looks for it in a map of such a room."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import lru_cache
from typing import Any

import numpy as np
from navigation.rooms import Ride, StandInLocalization
from places.seen_room import frame_at, kept, seen
from synthetic import BOXES, CAMERA, ROOM

from benchmarks.plain_rooms import CELL_M, MOUNT, WHEELS, RoomRobot, Wall, Walls
from wheelsight.config import KnownMapSettings, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import Keyframe, KeyframeStore
from wheelsight.core.messages import Event, VelocityCommand
from wheelsight.estimation import Localizer, LocalizerInStep
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import KnownFloor, Navigator, Transition
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.place_recognition import KnownMap

Pose = tuple[float, float, float]

CALIBRATION = Calibration.registered_camera(CAMERA, T_base_camera=MOUNT, wheels=WHEELS, source="test")
# Where somebody turned, and looked each way: what the map has seen.
_LOOKED_FROM, _VIEWS = (-0.8, 0.0), 24
_PERIODS_A_FRAME = 4


def _outline(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[Wall, ...]:
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return tuple(zip(corners, (*corners[1:], corners[0]), strict=True))


WALLS = Walls.of(*(wall for low, high in (ROOM, *BOXES) for wall in _outline(low, high)))


class PaintedRobot(RoomRobot):
    """It stands in the room with the textures of a seed."""

    def __init__(self, seed: int, pose: Pose) -> None:
        super().__init__(WALLS, pose)
        self.calibration, self.has_camera, self._seed = CALIBRATION, False, seed

    def step(self, command: VelocityCommand) -> list[Event]:
        events = super().step(command)
        if self._period % _PERIODS_A_FRAME == 0:
            events.append(frame_at(self.T_map_base @ MOUNT, seed=self._seed, stamp_s=self.now_s))
        return events


@lru_cache(maxsize=1)
def _seen() -> tuple[tuple[Keyframe, np.ndarray], ...]:
    turns = 2 * np.pi * np.arange(_VIEWS) / _VIEWS
    poses = [se3.from_plane(*_LOOKED_FROM, turn) @ MOUNT for turn in turns]
    return tuple((kept(seen(T)), T) for T in poses)


def _known(start: Pose | None) -> KnownMap:
    """The map of the room of seed 0, and where somebody says that the robot begins, as surely as is believed."""
    store, recognizer = KeyframeStore(), Recognizer()
    for keyframe, T_map_keyframe in _seen():
        recognizer.add(store.add(keyframe, T_map_keyframe), keyframe)
    s = KnownMapSettings()
    xy, level = [s.start_sigma_m] * 2, [0.02] * 3
    C = np.diag(np.square([*xy, *level, s.start_sigma_rad]))
    said = () if start is None else (se3.from_plane(*start) @ MOUNT, C)
    return KnownMap(store, recognizer, (), *said)


def _grid() -> OccupancyGrid:
    """Of the same room, as it is."""
    low, high = np.array(ROOM)[:, :2]
    kind = np.full(np.round((high - low) / CELL_M).astype(int)[::-1], CellKind.FREE, np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = CellKind.OBSTACLE
    for box in BOXES:
        (left, bottom), (right, top) = np.round((np.array(box)[:, :2] - low) / CELL_M).astype(int)
        kind[bottom:top, left:right] = CellKind.OBSTACLE
    return OccupancyGrid.of_kinds(kind, kind == CellKind.FREE, CELL_M, (float(low[0]), float(low[1])))


@contextmanager
def painted_ride(
    seed: int,
    pose: Pose,
    lost_s: float,
    start: Pose | None = None,
    localizers: list[Localizer] | None = None,
) -> Iterator[Ride]:
    """A ride in the room with textures of a seed; its map is of the room of seed 0."""
    overrides: dict[str, Any] = {"odometry": "wheels,dense", "loops.source": "keyframes", "loops.latency_s": 0.3}
    config = load_config(overrides={**overrides, "navigation.navigator.lost_s": lost_s})
    robot, transitions = PaintedRobot(seed, pose), list[Transition]()
    localizer = Localizer(CALIBRATION, config, known=_known(start), waits=True)
    if localizers is not None:
        localizers.append(localizer)
    with closing(LocalizerInStep(localizer)) as localization:
        how = {"trusts_floor": True, "on_transition": transitions.append}
        navigator = Navigator(robot, localization, KnownFloor(_grid()), config.navigation, **how)  # type: ignore[arg-type]
        yield Ride(robot, StandInLocalization(robot), navigator, transitions)
