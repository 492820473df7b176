"""The map of before in which a run is to find itself: opened, checked, and made ready to be recognised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.errors import ConfigError, MapError
from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.known import KnownMap
from wheelsight.slam.sessions import MapFolder, find_map, lie_together


def open_known(
    calibration: Calibration, config: Config, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> tuple[KnownMap, MapFolder] | None:
    """The map that settings name, and its folder; None where they name none.

    Keyframes that damage took, or of which nobody knows how they lie to the others, are not recognised.

    Args:
        calibration: of the robot: its camera has to be the map's.
        config: of the run.
        on_keyframe: called with how many codes are made, and of how many, where their file is missing.

    Raises:
        MapError: it is none, damaged, of another camera or version, or written by another run.
        ConfigError: a start is given, and the calibration does not say where the camera sits.
        OutputError: it is to be extended and cannot be written.
    """
    given = config.known_map
    if given.path is None:
        return None
    folder = MapFolder.open(find_map(given.path), read_only=not given.extend, settings=config.sessions)
    try:
        folder.check_camera(calibration, config.recording.depth_factor)
        together = lie_together(folder)
        if not together.any():
            raise MapError("has no keyframes", path=folder.path, fix="make a map by a run with --map surfels")
        recognizer = _of_these(folder.recognizer(config.recognition, on_keyframe), folder, together, config)
        start = _start(calibration, config)
        edges = folder.edges if given.extend else ()
        return KnownMap(folder.store, recognizer, edges, *start), folder
    except BaseException:
        folder.close()
        raise


def _of_these(found: Recognizer, folder: MapFolder, together: BoolArray, config: Config) -> Recognizer:
    """The recognizer, of keyframes that lie together alone."""
    if all(together[number] for number in found.keyframes):
        return found
    made = Recognizer(config.recognition)
    for number in np.flatnonzero(together):
        made.add(KeyframeId(int(number)), folder.store[KeyframeId(int(number))])
    return made


def _start(calibration: Calibration, config: Config) -> tuple[FloatArray | None, FloatArray | None]:
    """T_map_camera where the drive begins, and its covariance; None where nobody says."""
    given = config.known_map
    if given.start is None:
        return None, None
    if calibration.T_base_camera is None:
        problem = "--start says where the base is, and the calibration does not say where the camera sits on it"
        raise ConfigError(problem, fix="wheelsight calibrate base, or no --start")
    T_map_base = given.start.T_odom_base
    xy, level = given.start_sigma_m, given.level_sigma
    Ad = se3.adjoint(T_map_base)
    C = Ad @ np.diag(np.square([xy, xy, level, level, level, given.start_sigma_rad])) @ Ad.T
    return se3.nearest(T_map_base @ calibration.T_base_camera), C
