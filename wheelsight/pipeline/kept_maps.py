"""The map folders that a run leaves, for the next drive: begun, written while driving, and finished."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wheelsight.config import Config
from wheelsight.pipeline.kept_map_record import KeptMapRecord
from wheelsight.pipeline.track import Passage, Track, has_map
from wheelsight.slam.live import ClosedLoops
from wheelsight.slam.sessions import DRIVE, MAP_FOLDER, MapFolder, MapWriter, discard_map
from wheelsight.slam.sessions.map_folder import SURFELS_FILE
from wheelsight.sources import EventSource


@contextmanager
def keeping_maps(
    tracks: Sequence[Track], source: EventSource, config: Config, folder: Path, known: MapFolder | None = None
) -> Iterator[None]:
    """Let each track that is to leave a map write it, while the block runs; however it ends, what is written is a map.

    What an earlier run left in its place goes. A drive in a known map leaves none of its own: it extends that, or not.

    Raises:
        OutputError: the folder cannot be made, or holds something else.
        MapError: another run writes it.
    """
    try:
        for track in tracks:
            if known is not None:
                _extend(track, tracks, config, known)
            elif _is_asked(track, tracks, config):
                _begin(track, source, config, (folder if len(tracks) == 1 else folder / track.odometry) / MAP_FOLDER)
        yield
    finally:
        for track in tracks:
            _close(track)
        if known is not None:
            known.close()


def _extend(track: Track, tracks: Sequence[Track], config: Config, known: MapFolder) -> None:
    store = track.localizer.keyframes
    if config.known_map.extend and store is not None and has_map(track.odometry, [one.odometry for one in tracks]):
        track.map_writer, track.map_path, track.extends = MapWriter(known, store), known.path, True


def _begin(track: Track, source: EventSource, config: Config, path: Path) -> None:
    store = track.localizer.keyframes
    assert store is not None
    discard_map(path)
    factor = config.recording.depth_factor
    how: dict[str, Any] = {"source": source.name, "depth_factor": factor, "unfinished": DRIVE}
    kept = MapFolder.create(path, source.calibration, config.sessions, **how)
    # Who closes loops knows by what keyframes are recognised: once is enough, 13 kB a keyframe.
    recognition = config.recognition if track.localizer.loops is None else None
    track.map_writer, track.map_path = MapWriter(kept, store, recognition), path


def _close(track: Track) -> None:
    if track.map_writer is not None and track.map_path is not None:
        track.map_writer.close()
        if _is_empty(track.map_writer) and not track.extends:
            discard_map(track.map_path)


def _is_asked(track: Track, tracks: Sequence[Track], config: Config) -> bool:
    """Of a camera alone; of joined sensors one map is enough."""
    if track.localizer.keyframes is None:
        return False
    if not has_map(track.odometry, [one.odometry for one in tracks]):
        return False
    asked = config.sessions.keep_map
    return track.localizer.map is not None if asked is None else asked


def finish_map(track: Track, passage: Passage) -> KeptMapRecord | None:
    """Write what is left of a track's map, if it has one; no surfels where the run was torn within a frame."""
    writer, path = track.map_writer, track.map_path
    if writer is None or path is None:
        return None
    surfels = None if passage.is_torn or track.extends else track.localizer.map
    loops = track.localizer.loops
    if loops is None:
        writer.close(surfels)
    elif passage.is_torn:
        writer.close(surfels, None if track.extends else loops.recognizer)
    else:
        closed = loops.finish()
        if track.extends:
            is_whole = _add_to_known(writer, closed)
        else:
            writer.add_edges(closed.edges)
            is_whole = True
        writer.close(surfels, loops.recognizer if is_whole else None)
    if _is_empty(writer) and not track.extends:
        discard_map(path)
        return None
    return KeptMapRecord(path.name, writer.keyframes, _bytes_in(path), writer.warnings)


def _add_to_known(writer: MapWriter, closed: ClosedLoops) -> bool:
    """Add to a map of before what is known to lie in it; whether those are all keyframes of the drive.

    An edge of one that is not written would be taken for one of the next drive's, which will have its number.
    """
    if closed.is_joined:
        writer.look(None)  # those of a place that was recognised when the drive was over
    writer.add_edges([edge for edge in closed.edges if closed.known <= edge.second < writer.taken])
    return writer.taken == len(closed.T_map_keyframe)


def _is_empty(writer: MapWriter) -> bool:
    """Whether its drive has seen nothing, rather than not been able to write it."""
    return not writer.keyframes and not writer.warnings


def _bytes_in(folder: Path) -> int:
    try:
        return sum(file.stat().st_size for file in folder.iterdir() if file.is_file())
    except OSError:  # the disk is gone; the writer has said so
        return 0


def kept_surfels(track: Track) -> Path | None:
    """Where in its map folder a track's surfels are; None where that has none of this run."""
    if track.map_path is None or track.extends:
        return None
    path = track.map_path / SURFELS_FILE
    return path if path.is_file() else None
