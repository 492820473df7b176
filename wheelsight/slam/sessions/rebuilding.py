"""A map made anew of its keyframes, where they are by now: its surfels fused, its journals without what is outdated."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from wheelsight.errors import MapError
from wheelsight.files import StrPath
from wheelsight.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.mapping import SurfelMap, SurfelSettings
from wheelsight.odometry.dense.grid import Level
from wheelsight.odometry.dense.reference import ReferenceMaker
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.places.views import known_grey
from wheelsight.settings import RecognitionSettings
from wheelsight.slam.sessions.header import REBUILD
from wheelsight.slam.sessions.map_folder import MapFolder, make_room, map_being_made
from wheelsight.slam.sessions.occupancy import add_occupancy
from wheelsight.slam.sessions.parts import MapParts, Progress, SaidOfMap, edits_as_known, names_as_known
from wheelsight.threads import Rows
from wheelsight.views import Surface

# Between two keyframes that show a surface many seconds may pass: none of it is forgotten.
_KEPT_S = 1e6


def rebuild(
    folder: MapFolder,
    out: StrPath,
    surfels: SurfelSettings | None = None,
    recognition: RecognitionSettings | None = None,
    on_keyframe: Progress = lambda doing, done, total: None,
) -> MapFolder:
    """Write a map anew into another folder: keyframes where they are by now, edges that hold, and what is made of them.

    Args:
        folder: an open map; it stays as it is.
        out: a folder that is empty or not there, or that a merge, rebuild or prune left when it was ended.
        surfels, recognition: or the defaults.
        on_keyframe: called with what is being done, how many keyframes are done, and of how many.

    Returns the new map, open to read.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
        OutputError: it cannot be written.
    """
    make_room(out)
    said = SaidOfMap(edits_as_known(folder), names_as_known(folder))
    surfel_map = fused_anew(folder, surfels, lambda done, total: on_keyframe("fusing", done, total))
    with map_being_made(out, REBUILD, folder) as new:
        _copy_keyframes(folder, new, lambda done, total: on_keyframe("writing", done, total))
        new.append_edges(folder.edges)
        found = folder.recognizer(recognition, lambda done, total: on_keyframe("recognition", done, total))
        new.save_recognition(found)
        new.save_surfels(surfel_map)
        said.save(new)
        add_occupancy(new, on_keyframe)
    return MapFolder.open(out, settings=folder.settings)


def _copy_keyframes(folder: MapFolder, new: MapFolder, on_keyframe: Callable[[int, int], None]) -> None:
    numbers = list(folder.store)
    for done, number in enumerate(numbers, start=1):
        place = folder.contents.places[number]
        new.append_keyframe(number, folder.store[number], folder.store.pose(number), place.T_odom_keyframe)
        on_keyframe(done, len(numbers))


def fused_anew(
    folder: MapFolder,
    settings: SurfelSettings | None = None,
    on_keyframe: Callable[[int, int], None] = lambda done, total: None,
) -> SurfelMap:
    """Surfels of all keyframes, in the order of their stamps; grey, since keyframes keep no colour.

    Args:
        folder: an open map.
        settings: of surfels, or the defaults.
        on_keyframe: called with how many are done, and of how many.

    Raises:
        MapError: there are no keyframes, or one cannot be read.
    """
    places = folder.contents.places
    stamps_s = {number: places[number].stamp_s for number in folder.store}
    return _fused(folder.store, stamps_s, folder, settings, on_keyframe)


def fused_of(
    parts: MapParts, like: MapFolder, settings: SurfelSettings | None, on_keyframe: Callable[[int, int], None]
) -> SurfelMap:
    """Likewise of parts, of the camera and by the settings of a map. Raises MapError."""
    stamps_s = {KeyframeId(number): place.stamp_s for number, place in enumerate(parts.places)}
    return _fused(parts.store(like.settings.memory_keyframes), stamps_s, like, settings, on_keyframe)


def _fused(
    store: KeyframeStore,
    stamps_s: Mapping[KeyframeId, float],
    like: MapFolder,
    settings: SurfelSettings | None,
    on_keyframe: Callable[[int, int], None],
) -> SurfelMap:
    """Of the keyframes that have a stamp, in the order of that."""
    noise, numbers = like.calibration.depth_noise, sorted(stamps_s, key=lambda number: stamps_s[number])
    if not numbers:
        raise MapError("has no keyframes", path=like.path, fix="give a map of a drive that kept some")
    kept = {"unstable_s": _KEPT_S, "unseen_s": _KEPT_S}
    surfel_map, dense = SurfelMap((settings or SurfelSettings()).model_copy(update=kept), store), DenseSettings()
    maker = ReferenceMaker(noise, dense, Rows(dense.threads))
    for done, number in enumerate(numbers, start=1):
        keyframe = store[number]
        how = (keyframe.stamp_s, noise, like.settings.rebuild_frames, number)
        surfel_map.fuse(_surface(keyframe, maker), keyframe.intrinsics, store.pose(number), *how)
        on_keyframe(done, len(numbers))
    return surfel_map


def _surface(keyframe: Keyframe, maker: ReferenceMaker) -> Surface:
    level = Level(keyframe.intrinsics, keyframe.depth_m, known_grey(keyframe))
    return Surface(level.depth_m, maker.normals(level), level.grey)
