"""The map folders that a run leaves, for the next drive: begun, written while driving, and finished."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from wheelsight.config import Config
from wheelsight.files import StrPath
from wheelsight.mapping import SurfelMap, save_map
from wheelsight.pipeline.kept_map_record import KeptMapRecord
from wheelsight.pipeline.track import Passage, Track
from wheelsight.slam.sessions import MAP_FOLDER, MapFolder, MapWriter, discard_map
from wheelsight.slam.sessions.map_folder import SURFELS_FILE
from wheelsight.sources import EventSource


def begin_maps(tracks: Sequence[Track], source: EventSource, config: Config, folder: Path) -> None:
    """Let each track that is to leave a map write it; what an earlier run left in its place goes.

    Raises:
        OutputError: the folder cannot be made, or holds something else.
        MapError: another run writes it.
    """
    settings = config.sessions
    for track in tracks:
        store = track.localizer.keyframes
        if store is None or not _is_asked(track, tracks, config):
            continue
        path = map_path(folder, track, tracks)
        discard_map(path)
        facts = {"source": source.name, "depth_factor": config.recording.depth_factor}
        kept = MapFolder.create(path, source.calibration, settings, **facts)
        track.map_writer, track.map_path = MapWriter(kept, store, config.recognition), path


def _is_asked(track: Track, tracks: Sequence[Track], config: Config) -> bool:
    """Of joined sensors one map is enough."""
    if track.odometry != "joined" and any(other.odometry == "joined" for other in tracks):
        return False
    asked = config.sessions.keep_map
    return track.localizer.map is not None if asked is None else asked


def map_path(folder: Path, track: Track, tracks: Sequence[Track]) -> Path:
    """Beside the track's other results."""
    return (folder if len(tracks) == 1 else folder / track.odometry) / MAP_FOLDER


def finish_map(track: Track, passage: Passage) -> KeptMapRecord | None:
    """Write what is left of a track's map, if it has one; no surfels where the run was torn within a frame."""
    writer, path = track.map_writer, track.map_path
    if writer is None or path is None:
        return None
    writer.close(None if passage.is_torn else track.localizer.map)
    size = sum(file.stat().st_size for file in path.iterdir() if file.is_file())
    return KeptMapRecord(path.name, writer.keyframes, size, writer.warnings)


def close_maps(tracks: Sequence[Track]) -> None:
    """Whatever happened: what has been written stays a map."""
    for track in tracks:
        if track.map_writer is not None:
            track.map_writer.close()


def save_surfels(surfel_map: SurfelMap, path: StrPath, map_folder: Path | None) -> None:
    """Write the surfel map of a run; where its map folder has the same file already, as another name of that.

    Files are replaced and never changed, so that one may have two names. Raises OutputError.
    """
    path = Path(path)
    if map_folder is not None and (map_folder / SURFELS_FILE).is_file():
        try:
            path.unlink(missing_ok=True)
            os.link(map_folder / SURFELS_FILE, path)
        except OSError:  # a file system without links
            pass
        else:
            return
    save_map(surfel_map, path)
