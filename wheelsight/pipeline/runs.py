"""A run in a few verbs: check, follow, judge, write."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from wheelsight.config import Config
from wheelsight.errors import ConfigError
from wheelsight.files import StrPath, make_output_folder
from wheelsight.localizer import Places
from wheelsight.localizer.choice import NO_PARTS, OwnParts
from wheelsight.pipeline.choice import resolved
from wheelsight.pipeline.kept_maps import keeping_maps
from wheelsight.pipeline.known_maps import open_known
from wheelsight.pipeline.loops import MatchesOfRun, matches_of_run
from wheelsight.pipeline.origin import frame_count_of, wheel_count_of, where
from wheelsight.pipeline.outputs import Draw, write_results
from wheelsight.pipeline.places import PlacesOfRun, places_of
from wheelsight.pipeline.realtime import RealTimeRecording
from wheelsight.pipeline.records import records_of
from wheelsight.pipeline.run_record import FrameRecord, RunRecord
from wheelsight.pipeline.track import UNITS, Passage, Track, Watcher, begin_all, follow
from wheelsight.recordings import Recording
from wheelsight.recordings.clocks import FRAMES, WHEELS, refuse_if_apart, refuse_other_units
from wheelsight.slam.sessions import MapFolder
from wheelsight.sources import EventSource

_LOG = logging.getLogger(__name__)


def run_each(
    source: EventSource,
    config: Config,
    out: StrPath,
    *,
    force: bool = False,
    on_ready: Callable[[], None] = lambda: None,
    on_code: Callable[[int, int], None] = lambda done, total: None,
    on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None,
    draw: Draw | None = None,
    duration_s: float | None = None,
    watcher: Watcher | None = None,
    parts: OwnParts = NO_PARTS,
) -> tuple[RunRecord, ...]:
    """Run every odometry that `config` names over one pass of the events, alone and joined, and report them together.

    One leaves its results in `out`, each of several in a folder of its name there. What was tracked until Ctrl-C, or
    until the source breaks off, is written before the exception goes on.

    Args:
        source: a recording, also one `in_real_time`, or what gives events without an end.
        config: all settings; where it names no odometry, all sensors of the source are joined.
        out, force: folder for the results, made if need be; whether it may hold something.
        on_ready, on_code: called before the first event; while keyframes of a known map are made ready, with how many.
        on_event, watcher: called after each event that was answered, with each odometry's answer by its name.
        draw: writes a page of the records to a path, such as `report.write_page`; None: no page.
        duration_s: ends so many seconds after the first event, by its stamp; None: with the source.
        parts: of a user's own.

    Raises:
        InputError: what cannot end well, before anything is written; or the source cannot be read on.
    """
    config = resolved(source, config, parts)
    tracks, places, matches, known = _begin(source, config, on_code, parts)
    folder = make_output_folder(Path(out), force)
    on_ready()
    with keeping_maps(tracks, source, config, folder, known):
        passage = follow(tracks, source, config, on_event, _areas_of(places), duration_s, watcher)
        _raise_where_nothing(passage)
        records = records_of(passage, source, config, places, matches)
        _log(records)
        _show_end(watcher, passage)
    write_results(records, passage, source, config, folder, draw)
    _raise_interruption(passage)
    return records


def _log(records: tuple[RunRecord, ...]) -> None:
    """Warnings that no localizer has logged, and how many frames have a pose."""
    logged = {sentence for record in records for sentence in record.faults}
    for sentence in dict.fromkeys(sentence for record in records for sentence in record.warnings):
        if sentence not in logged:
            _LOG.warning(sentence)
    for record in records:
        posed = len(record.estimate), len(record.frames), record.unit
        _LOG.info("%s, %s: %d poses; %d %ss", record.recording, record.odometry, *posed)


def _areas_of(places: PlacesOfRun | None) -> Places | None:
    return None if places is None else places.places


def _raise_interruption(passage: Passage) -> None:
    if passage.interruption is not None:
        raise passage.interruption


def _show_end(watcher: Watcher | None, passage: Passage) -> None:
    """Nothing of a run that was torn within a step: what was being built then is not to be trusted."""
    if watcher is not None and not passage.is_torn:
        watcher.finish(passage.tracks)


def _raise_where_nothing(passage: Passage) -> None:
    """Ctrl-C before anything was answered leaves nothing to write."""
    if isinstance(passage.interruption, KeyboardInterrupt) and not any(track.frames for track in passage.tracks):
        raise passage.interruption


class _Begun(NamedTuple):
    """All that a run needs before its first event; `known` is the folder of the map in which it is to find itself."""

    tracks: tuple[Track, ...]
    places: PlacesOfRun | None
    matches: MatchesOfRun | None
    known: MapFolder | None


def _begin(source: EventSource, config: Config, on_code: Callable[[int, int], None], parts: OwnParts) -> _Begun:
    """Every track at its start, and places and matches if they are asked for.

    Raises:
        ConfigError: the source has no images, wheel readings or matches that are asked for.
        CalibrationError: the calibration lacks its cameras, or its wheels.
        AreaError, PlaceError: places cannot be read, or do not fit.
        RecordingError: stamps are no seconds, or wheels and camera, which are to be joined, share no time.
    """
    _check_sensors(source, config)
    places, matches = places_of(source, config), matches_of_run(source, config)
    known, folder = open_known(source.calibration, config, on_code) or (None, None)
    try:
        tracks = begin_all(source, config, None if places is None else places.places, known, parts)
        _check_clocks(source, config)
    except BaseException:
        if folder is not None:
            folder.close()
        raise
    return _Begun(tracks, places, matches, folder)


def _check_sensors(source: EventSource, config: Config) -> None:
    """Refuse odometries of sensors that the source does not have. Raises ConfigError."""
    wheels = source.wheels if isinstance(source, RealTimeRecording) else None
    if wheels is not None and (config.odometry == ("wheels",) or "wheels" not in config.odometry):
        raise ConfigError(f"wheels from {wheels.where} are played beside a camera", fix="--odometry wheels,dense")
    for odometry in config.odometry:
        if UNITS[odometry] == "reading" and wheels is None and wheel_count_of(source) == 0:
            raise ConfigError(f"{where(source)}: the recording has no wheel readings", fix="--odometry features")
        if UNITS[odometry] == "frame" and wheel_count_of(source) and frame_count_of(source) == 0:
            raise ConfigError(f"{where(source)}: the recording has no images", fix="--odometry wheels")


def _check_clocks(source: EventSource, config: Config) -> None:
    """Refuse stamps that are no seconds, and to join what shares no time. Raises RecordingError."""
    played = source.played if isinstance(source, RealTimeRecording) and source.wheels is None else source
    is_joined = bool({"joined", "rectified"} & set(config.tracks))
    if not isinstance(played, Recording) or isinstance(played, RealTimeRecording):
        return
    if is_joined:
        refuse_if_apart(played)
    refuse_other_units(played, {FRAMES if UNITS[odometry] == "frame" else WHEELS for odometry in config.odometry})
