"""DriveMaps: the known maps that can be driven in, and new maps that are made while driving, each in its own folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.app.page.snapshot import Driven
from wheelsight.app.run.drives import drive_in_map, exploring
from wheelsight.config import Config, KnownMapSettings, StartSettings
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.files import StrPath, make_output_folder
from wheelsight.core.geometry import FloatArray
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.robots import Robot
from wheelsight.mapping import NamedPose, NamedPoses, OccupancyGrid, roomiest_place
from wheelsight.navigation import Transition
from wheelsight.slam.maps import MAP_FOLDER, MapFolder, find_map, in_largest_piece
from wheelsight.slam.maps.contents import current_edits, current_named_poses

NEW = "a new map"


class DriveMaps:
    """The known maps that can be driven in, and new maps that are made while driving.

    Args:
        config: of the drives, with loops by keyframes and no known map.
        known: the first map, or None.
        start: the robot's first pose in it; None: it is recognised.
        out: folder of new maps, each in a folder named after its time; None: no new maps.
        in_step: as of `drive_in_map`.

    Raises:
        ConfigError: neither a map nor a folder for a new one.
        MapError: there is no map at `known`.
    """

    def __init__(
        self, config: Config, known: StrPath | None, start: StartSettings | None, out: StrPath | None, *, in_step: bool
    ) -> None:
        if known is None and out is None:
            raise ConfigError("there is no map to drive in", fix="--map DIR; or --out DIR, which a new one goes to")
        self._config, self._in_step = config, in_step
        self._out = None if out is None else Path(out)
        self._start, self._saved = start, ""
        self._paths: dict[str, Path] = {}  # by the names of their folders, the newest first
        folders = () if self._out is None or not self._out.is_dir() else self._out.iterdir()
        for folder in sorted(folders, reverse=True):
            with suppress(MapError):
                self._paths[folder.name] = find_map(folder)
        self.first = NEW
        if known is not None:
            self.first = Path(known).resolve().name or str(known)
            self._paths = {self.first: find_map(known), **self._paths}

    def names(self) -> tuple[str, ...]:
        """See `Maps`: known maps, the newest first, and a new one if there is a folder for it."""
        return (*self._paths, *(() if self._out is None else (NEW,)))

    def last_saved(self) -> str:
        """See `Maps`."""
        return self._saved

    @contextmanager
    def opened(
        self, name: str, robot: Robot, pose: FloatArray | None, on_transition: Callable[[Transition], None]
    ) -> Iterator[Driven]:
        """See `Maps`."""
        if name == NEW:
            with self._making(robot, on_transition) as driven:
                yield driven
            return
        start = self._start if name == self.first else None
        if pose is not None:
            x_m, y_m, yaw = map(float, pose)
            start = StartSettings(x_m=x_m, y_m=y_m, yaw_deg=float(np.degrees(yaw)))
        # Where it stood when the program began is no news for another time.
        self._start = None
        path = self._paths[name]
        known = KnownMapSettings(path=str(path), start=start)
        config = self._config.model_copy(update={"known_map": known})
        with drive_in_map(
            robot, config, in_step=self._in_step, takes_real_time=True, trusts_floor=True, on_transition=on_transition
        ) as drive:
            yield Driven(drive.navigator, KnownPlaces(path, drive.grid), is_new=False)

    @contextmanager
    def _making(self, robot: Robot, on_transition: Callable[[Transition], None]) -> Iterator[Driven]:
        assert self._out is not None
        # A new name by the current time
        name = time.strftime("%Y-%m-%d %H.%M.%S")
        number = 1
        while (self._out / name).exists():
            number += 1
            name = f"{name.partition(' (')[0]} ({number})"
        path = make_output_folder(self._out / name) / MAP_FOLDER
        how: dict[str, Any] = {"in_step": self._in_step, "takes_real_time": True, "trusts_floor": True}
        with exploring(robot, self._config, path, **how, on_transition=on_transition) as drive:
            store = drive.navigator.senses.localization.keyframes
            assert store is not None
            places = NewPlaces(store)
            yield Driven(drive.navigator, places, is_new=True)
        if len(places.named):
            with closing(MapFolder.open(path, read_only=False)) as folder:
                folder.save_named_poses(places.named)
        self._paths = {name: path, **self._paths}
        self._saved = name


class KnownPlaces:
    """Named places of a known map. Changes are written at once.

    Args:
        path: of the map's folder.
        grid: occupancy grid. With it each area with free floor is a place, too: its point of most clearance.

    Raises:
        MapError: a file of it is damaged.
    """

    def __init__(self, path: Path, grid: OccupancyGrid | None = None) -> None:
        self._path, self._areas = path, dict[str, FloatArray]()
        with closing(MapFolder.open(path)) as folder:
            table = folder.store.T_map_keyframe
            self._where = _where(current_named_poses(folder), table)
            if grid is not None:
                edits = current_edits(folder)
                found = {area.name or "": roomiest_place(grid, area.polygon_now(table)) for area in edits.areas}
                self._areas = {name: np.array([*at, np.nan]) for name, at in found.items() if at is not None}

    def where(self) -> Mapping[str, FloatArray]:
        """See `Places`; a named pose wins over an area of the same name."""
        return {**self._areas, **self._where}

    def name(self, name: str, pose: FloatArray) -> None:
        """See `Places`."""
        with closing(MapFolder.open(self._path, read_only=False)) as folder:
            table = folder.store.T_map_keyframe
            # A keyframe of unknown position must not carry a named pose.
            hung = NamedPose(name, pose).attached_to_nearest(table, np.flatnonzero(in_largest_piece(folder)))
            named = folder.named_poses().with_pose(hung)
            folder.save_named_poses(named)
            self._where = _where(current_named_poses(folder), table)


class NewPlaces:
    """Named places of a new map. They move with its keyframes, and are written with it."""

    def __init__(self, store: KeyframeStore) -> None:
        self._store, self.named = store, NamedPoses()

    def where(self) -> Mapping[str, FloatArray]:
        """See `Places`."""
        return _where(self.named, self._store.T_map_keyframe)

    def name(self, name: str, pose: FloatArray) -> None:
        """See `Places`."""
        table = self._store.T_map_keyframe.copy()
        self.named = self.named.with_pose(NamedPose(name, pose).attached_to_nearest(table, np.arange(len(table))))


def _where(named: NamedPoses, T_map_keyframe: FloatArray) -> dict[str, FloatArray]:
    return {one.name: one.pose_now(T_map_keyframe) for one in named}
