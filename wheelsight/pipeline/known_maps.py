"""The map of before in which a run is to find itself: opened, checked, and made ready to be recognised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from wheelsight.calibration import Calibration
from wheelsight.config import Config
from wheelsight.errors import ConfigError, MapError
from wheelsight.geometry import BoolArray, FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.known import KnownMap
from wheelsight.slam.sessions import MapFolder, find_map
from wheelsight.sources import EventSource

# An edge that is less sure, as of a camera that was carried off, does not tell how its ends lie to each other.
_SURE_M, _SURE_RAD = 0.5, 0.3


def open_known(
    source: EventSource, config: Config, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> tuple[KnownMap, MapFolder] | None:
    """The map that settings name, and its folder; None where they name none.

    Keyframes that damage took, or of which nobody knows how they lie to the others, are not recognised.

    Args:
        source: whose camera it has to be.
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
        folder.check_camera(source.calibration, config.recording.depth_factor)
        together = lie_together(folder)
        if not together.any():
            raise MapError("has no keyframes", path=folder.path, fix="make a map by a run with --map surfels")
        recognizer = _of_these(folder.recognizer(config.recognition, on_keyframe), folder, together, config)
        start = _start(source.calibration, config)
        edges = folder.edges if given.extend else ()
        return KnownMap(folder.store, recognizer, edges, *start), folder
    except BaseException:
        folder.close()
        raise


def lie_together(folder: MapFolder) -> BoolArray:
    """(N,) which keyframes of a map hang together by edges that are sure: the largest such piece."""
    count = len(folder.store)
    there: BoolArray = np.asarray(np.isfinite(folder.store.T_map_keyframe).all(axis=(1, 2)))
    there[[int(number) for number in folder.store.missing]] = False
    sure = [(edge.first, edge.second) for edge in folder.edges if _is_sure(edge.covariance)]
    ends = np.array([pair for pair in sure if max(pair) < count], np.int64).reshape(-1, 2)
    ends = ends[there[ends].all(axis=1)]
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, piece = connected_components(graph, directed=False)
    if not there.any():
        return there
    largest = np.bincount(piece[there]).argmax()
    return np.asarray(there & (piece == largest))


def _is_sure(covariance: FloatArray) -> bool:
    sigmas = np.sqrt(np.diag(covariance))
    return bool((sigmas[:3] < _SURE_M).all() and (sigmas[3:] < _SURE_RAD).all())


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
