"""Runs a recording or live sensors: checks, tracks, judges, writes. Holds the writers of all result files, metrics.json
and covariances among them.
"""

from __future__ import annotations

import json
import logging
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Any, get_args

import numpy as np

from wheelsight._version import __version__
from wheelsight.app.run import words
from wheelsight.app.run.loops import CORRECTED_FILE, JUDGED_FILE, MatchesOfRun, judged_csv, matches_of_run
from wheelsight.app.run.maps import MAP_FILE, open_known
from wheelsight.app.run.places import PlacesOfRun, looks_csv, places_of
from wheelsight.app.run.realtime import RealTimeRecording
from wheelsight.app.run.records import keeping_maps, kept_surfels, records_of
from wheelsight.app.run.run_record import FrameRecord, RectificationRecord, RunRecord
from wheelsight.app.run.run_source import format_of, frame_count_of, path_of, resolved, wheel_count_of, where
from wheelsight.app.run.track import UNITS, Passage, RunTrack, Watcher, begin_all, follow
from wheelsight.app.run.verdict import JoinedFacts, best_alone_of, facts_of, joined_of, verdict_of, verdict_of_run
from wheelsight.config import Config, TrackName, save_config
from wheelsight.core.errors import ConfigError, TrajectoryError
from wheelsight.core.files import StrPath, make_output_folder, output_error, write_lines, write_text
from wheelsight.core.inputs import Kind, lines_of, read_text
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.io.recordings import Recording
from wheelsight.io.recordings.clock_checks import FRAMES, WHEELS, refuse_if_apart, refuse_other_units
from wheelsight.mapping import save_map
from wheelsight.slam.maps import MAP_FOLDER, MapFolder, discard_map

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
    """Run every odometry of `config`, alone and joined, over one pass of the events, and write the results.

    A single odometry writes into `out`, each of several into a folder of its name there. After Ctrl-C or an error of
    the source, the results so far are written before the exception goes on.

    Args:
        source: a recording, also one `in_real_time`, or a live source without an end.
        config: all settings; without an odometry, all sensors of the source are joined.
        out, force: folder for the results, made if needed; whether it may hold other files.
        on_ready, on_code: called before the first event; and with (done, total) while codes of a known map are made.
        on_event, watcher: called after each answered event, with the answer of each odometry by its name.
        draw: writes a page of the records to a path, such as `report.write_page`; None: no page.
        duration_s: duration of the run from the first event, by stamps; None: until the source ends.
        parts: user-defined parts.

    Raises:
        InputError: invalid inputs, before anything is written; or the source fails during the run.
    """
    config = resolved(source, config, parts)
    tracks, places, matches, known = _begin(source, config, on_code, parts)
    folder = make_output_folder(Path(out), force)
    on_ready()
    with keeping_maps(tracks, source, config, folder, known):
        areas = None if places is None else places.places
        passage = follow(tracks, source, config, on_event, areas, duration_s, watcher)
        if isinstance(passage.interruption, KeyboardInterrupt) and not any(track.frames for track in passage.tracks):
            raise passage.interruption
        records = records_of(passage, source, config, places, matches)
        # The localizers have logged faults already.
        logged = {sentence for record in records for sentence in record.faults}
        for sentence in dict.fromkeys(sentence for record in records for sentence in record.warnings):
            if sentence not in logged:
                _LOG.warning(sentence)
        for record in records:
            posed = len(record.estimate), len(record.frames), record.unit
            _LOG.info("%s, %s: %d poses; %d %ss", record.recording, record.odometry, *posed)
        if watcher is not None and not passage.is_torn:
            watcher.finish(passage.tracks)
    write_results(records, passage, source, config, folder, draw)
    if passage.interruption is not None:
        raise passage.interruption
    return records


def _begin(
    source: EventSource, config: Config, on_code: Callable[[int, int], None], parts: OwnParts
) -> tuple[tuple[RunTrack, ...], PlacesOfRun | None, MatchesOfRun | None, MapFolder | None]:
    """Make every track, places and matches if requested, and the folder of the known map.

    Raises:
        ConfigError: the source lacks requested images, wheel readings or matches.
        CalibrationError: the calibration lacks cameras or wheels.
        AreaError, PlaceError: places cannot be read, or do not fit.
        RecordingError: stamps are not in seconds, or wheels and camera to be joined share no time.
    """
    # Each odometry needs its sensor.
    wheels = source.wheels if isinstance(source, RealTimeRecording) else None
    if wheels is not None and (config.odometry == ("wheels",) or "wheels" not in config.odometry):
        raise ConfigError(f"wheels from {wheels.where} are played beside a camera", fix="--odometry wheels,dense")
    for odometry in config.odometry:
        if UNITS[odometry] == "reading" and wheels is None and wheel_count_of(source) == 0:
            raise ConfigError(f"{where(source)}: the recording has no wheel readings", fix="--odometry features")
        if UNITS[odometry] == "frame" and wheel_count_of(source) and frame_count_of(source) == 0:
            raise ConfigError(f"{where(source)}: the recording has no images", fix="--odometry wheels")
    places, matches = places_of(source, config), matches_of_run(source, config)
    known, folder = open_known(source.calibration, config, on_code) or (None, None)
    try:
        tracks = begin_all(source, config, None if places is None else places.places, known, parts)
        # Stamps must be in seconds, and joined sensors must share time.
        played = source.played if isinstance(source, RealTimeRecording) and source.wheels is None else source
        is_joined = bool({"joined", "rectified"} & set(config.tracks))
        if isinstance(played, Recording) and not isinstance(played, RealTimeRecording):
            if is_joined:
                refuse_if_apart(played)
            refuse_other_units(
                played, {FRAMES if UNITS[odometry] == "frame" else WHEELS for odometry in config.odometry}
            )
    except BaseException:
        if folder is not None:
            folder.close()
        raise
    return tracks, places, matches, folder


# Figures: metrics.json


def metrics_of(
    record: RunRecord, passage: Passage, source: EventSource, records: Sequence[RunRecord] = ()
) -> dict[str, Any]:
    """The figures of one odometry and of its pass; `records` are those of all odometries."""
    return {
        "recording": _recording(source),
        "frame": f"T_{record.estimate.frame}_{record.estimate.body}",
        "interrupted": passage.interruption is not None,
        **_real_time(record),
        **_of_odometry(record, passage, source, records),
        "peak_memory_mb": record.peak_memory_mb,
        "warnings": list(record.warnings),
        "versions": _versions(),
    }


def joint_metrics(records: Sequence[RunRecord], passage: Passage, source: EventSource) -> dict[str, Any]:
    """The figures of every odometry of one pass: common ones once, the others by odometry."""
    shared = [*source.warnings, *passage.unused]
    of_each = {
        record.odometry: {
            "frame": f"T_{record.estimate.frame}_{record.estimate.body}",
            **_of_odometry(record, passage, source, records),
            "warnings": [warning for warning in record.warnings if warning not in shared],
        }
        for record in records
    }
    # Joined sensors compared with the better single one
    if joined_of(records) is None:
        beside_alone = {}
    else:
        best_alone = best_alone_of(records)
        beside_alone = {
            "joined_beside_alone": None
            if best_alone is None
            else {"better": best_alone.odometry, "ate_ratio": best_alone.ratio}
        }
    return {
        "recording": _recording(source),
        "interrupted": passage.interruption is not None,
        "verdict": verdict_of_run(records).to_dict(),
        "elapsed_s": passage.elapsed_s,
        **_real_time(records[0]),
        "odometry": of_each,
        **beside_alone,
        "peak_memory_mb": max((r.peak_memory_mb for r in records if r.peak_memory_mb is not None), default=None),
        "warnings": shared,
        "versions": _versions(),
    }


def _recording(source: EventSource) -> dict[str, str | None]:
    path = path_of(source)
    return {"name": source.name, "format": format_of(source), "path": None if path is None else str(path)}


def _real_time(record: RunRecord) -> dict[str, Any]:
    """Figures of a playback in real time."""
    return {} if record.realtime is None else {"realtime": record.realtime.to_dict()}


def _of_odometry(
    record: RunRecord, passage: Passage, source: EventSource, records: Sequence[RunRecord]
) -> dict[str, Any]:
    # Processing times without image decoding. The first frame may compile kernels, so it is separate. `elapsed_s` and
    # the throughput are of the whole pass, which all odometries share.
    used_ms = [1e3 * frame.seconds for frame in record.frames if not frame.is_skipped]
    later_ms = used_ms[1:]
    timing = {
        "frame_median_ms": float(np.median(later_ms)) if later_ms else None,
        "frame_p95_ms": float(np.percentile(later_ms, 95)) if later_ms else None,
        "frame_max_ms": max(later_ms, default=None),
        "first_frame_ms": used_ms[0] if used_ms else None,
        "stages_median_ms": {stage: 1e3 * seconds for stage, seconds in record.stage_seconds.items()},
        "elapsed_s": passage.elapsed_s,
        "throughput_frames_per_s": len(record.frames) / passage.elapsed_s if passage.elapsed_s else None,
    }
    frames = [frame for frame in record.frames if not frame.is_repeat]
    statuses = [str(frame.status) for frame in frames]
    reasons = [str(frame.reason) for frame in frames if frame.reason is not None]
    paired, surfels = record.association, record.map
    return {
        "verdict": verdict_of(record, records).to_dict(),
        "frames" if record.unit == "frame" else "wheel_readings": {
            "listed": frame_count_of(source) if record.unit == "frame" else wheel_count_of(source),
            "processed": len(frames),
            "with_pose": record.posed,
            "with_pose_share": record.posed / len(frames) if frames else 0.0,
            "skipped": sum(frame.is_skipped for frame in frames),
            "repeated_images": len(record.frames) - len(frames),
            "dropped": None if record.drops is None else record.drops.to_dict(),
            "left_out": {why: {"count": count, "of": of} for why, (count, of) in record.left_out.items()},
            "dropped_color_images": None if paired is None else paired.dropped_color,
            "dropped_depth_images": None if paired is None else paired.dropped_depth,
            "status": {status: statuses.count(status) for status in sorted(set(statuses))},
            "reasons": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        },
        "timing": timing,
        "trajectory": {"length_m": record.estimate.length_m, "duration_s": record.estimate.duration_s},
        "evaluation": None if record.evaluation is None else record.evaluation.to_dict(),
        "evaluation_problem": record.evaluation_problem,
        **(
            {}
            if surfels is None
            else {"map": {"file": surfels.file, "frames_fused": surfels.fused, **asdict(surfels.status)}}
        ),
        **({} if record.rectification is None else {"rectification": _rectification(record.rectification)}),
        **({} if record.correction is None else {"loops": record.correction.to_dict()}),
        **({} if record.known_map is None else {"known_map": record.known_map.to_dict()}),
        **({} if record.kept_map is None else {"kept_map": record.kept_map.to_dict()}),
        **({"joined": _joined(facts_of(record))} if record.is_joined else {}),
    }


def _joined(facts: JoinedFacts) -> dict[str, Any]:
    """Times by status of joined sensors, and whether errors match their stated uncertainty."""
    found = facts.consistency
    return {
        "seconds_by_status": facts.seconds,
        "coasting_episodes": len(facts.coasting_s),
        "longest_coasting_s": max(facts.coasting_s, default=0.0),
        "flag_shares": facts.flag_shares,
        "poses_at_frames": facts.poses_at_frames,
        "poses_at_wheel_readings_alone": facts.poses_at_readings,
        "consistency": None
        if found is None
        else {
            "within_three_sigma_share": _finite(found.share),
            "way_m": found.way_m,
            "drift_at_end_m": found.drift_m,
            "drift_share_of_way": _finite(found.drift_share),
        },
    }


def _rectification(found: RectificationRecord) -> dict[str, Any]:
    """Figures of areas: counts, shares of frames, and errors in the map without alignment."""
    errors, belief = found.errors, found.belief
    measured = sum(look.probabilities is not None for look in found.looks)
    return {
        "way": found.way,
        "start": found.start,
        "areas": list(found.areas.names),
        "frames_without_measurement": len(found.looks) - measured,
        "frames_with_an_area_named": sum(look.named >= 0 for look in found.looks),
        "model_accuracy": _finite(found.accuracy(found.forest)),
        "belief_accuracy": None if belief is None else _finite(found.accuracy(belief)),
        "lowest_trust": _finite(np.nanmin(found.trust)) if np.isfinite(found.trust).any() else None,
        "map_error_m": None
        if errors is None
        else {"wheels": asdict(errors.wheels), "rectified": asdict(errors.rectified)},
        "share_of_mean_error_left": None if errors is None else _finite(errors.left),
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _versions() -> dict[str, str]:
    import cv2
    import numba

    return {
        "wheelsight": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "opencv": cv2.__version__,
        "platform": platform.platform(),
    }


COVARIANCES_FILE = "covariances.csv"
_AXES = ("vx", "vy", "vz", "wx", "wy", "wz")
_UPPER = np.triu_indices(6)
_HEADER = ",".join(["stamp_s", *(f"{_AXES[row]}_{_AXES[column]}" for row, column in zip(*_UPPER, strict=True))])
# 200 bytes a pose; 1 500 000 of them, as many as a trajectory may have.
_FILE = Kind("covariances", most_mb=384)


def write_covariances(trajectory: Trajectory, path: StrPath) -> None:
    """Write the covariances of a trajectory as a table: a stamp and 21 numbers a row, of left perturbations (v, ω).

    Raises OutputError.
    """
    assert trajectory.covariances is not None
    stamps = (words.stamp(stamp_s) for stamp_s in trajectory.stamps_s)
    rows = (",".join(f"{value:.6g}" for value in C[_UPPER]) for C in trajectory.covariances)
    lines = (f"{stamp},{row}\n" for stamp, row in zip(stamps, rows, strict=True))
    write_lines(path, chain([f"{_HEADER}\n"], lines))


def with_covariances(trajectory: Trajectory, path: StrPath) -> Trajectory:
    """Read the covariances for a trajectory. Raises TrajectoryError if the table is of another trajectory."""
    path = Path(path)
    first, *lines = lines_of(read_text(path, _FILE, TrajectoryError)) or [""]
    try:
        rows = np.array([[float(value) for value in line.split(",")] for line in lines if line.strip()])
    except ValueError as error:
        raise TrajectoryError("a line is no row of numbers", path=path, fix="run again") from error
    fits = first == _HEADER and rows.shape == (len(trajectory), 1 + len(_UPPER[0])) and np.isfinite(rows).all()
    if not fits or not np.array_equal(rows[:, 0], trajectory.stamps_s):
        raise TrajectoryError("does not have one line for each pose of trajectory.txt", path=path, fix="run again")
    C = np.zeros((len(rows), 6, 6))
    C[:, _UPPER[0], _UPPER[1]] = C[:, _UPPER[1], _UPPER[0]] = rows[:, 1:]
    return replace(trajectory, covariances=C)


PAGE_FILE = "report.html"
STATUS_FILE, METRICS_FILE, TRAJECTORY_FILE = "status.csv", "metrics.json", "trajectory.txt"
ODOM_FILE = "odom.txt"
_OF_ONE = (
    TRAJECTORY_FILE,
    ODOM_FILE,
    COVARIANCES_FILE,
    STATUS_FILE,
    METRICS_FILE,
    "areas.csv",
    CORRECTED_FILE,
    JUDGED_FILE,
    MAP_FILE,
)


Draw = Callable[[Sequence[RunRecord], Path], None]


def write_results(
    records: Sequence[RunRecord],
    passage: Passage,
    source: EventSource,
    config: Config,
    folder: Path,
    draw: Draw | None = None,
) -> None:
    """Write all results of a run: one odometry into `folder`, each of several into a folder of its name, and the joint
    ones.

    `draw` writes the page. Results of an earlier run under these names are removed. Raises OutputError.
    """
    if (folder / "config.yaml").exists():  # a run's folder, not just any
        # Remove results of odometries that this run does not have: a reader would take them for its own
        kept = {folder} if len(records) == 1 else {folder / record.odometry for record in records}
        for place in {folder, *(folder / name for name in get_args(TrackName))} - kept:
            try:
                for name in _OF_ONE:
                    (place / name).unlink(missing_ok=True)
                discard_map(place / MAP_FOLDER)
                if place.is_dir() and place != folder and not any(place.iterdir()):
                    place.rmdir()
            except OSError as error:
                raise output_error(error, place) from error
    save_config(config, folder / "config.yaml")
    if len(records) == 1:
        _write_one(records[0], passage, source, folder)
    else:
        for record in records:
            _write_one(record, passage, source, make_output_folder(folder / record.odometry, force=True), records)
        _write_json(joint_metrics(records, passage, source), folder / METRICS_FILE)
    if draw is None:
        _forget(folder / PAGE_FILE)
    else:
        draw(records, folder / PAGE_FILE)


def _write_one(
    record: RunRecord, passage: Passage, source: EventSource, folder: Path, records: Sequence[RunRecord] = ()
) -> None:
    # First: none is left of another run.
    for name in _OF_ONE:
        _forget(folder / name)
    write_tum(record.estimate, folder / TRAJECTORY_FILE)
    if record.odom is not None:
        write_tum(record.odom, folder / ODOM_FILE)
    if record.estimate.covariances is not None:
        write_covariances(record.estimate, folder / COVARIANCES_FILE)
    write_text(folder / STATUS_FILE, status_csv(record))
    if record.rectification is not None:
        write_text(folder / "areas.csv", looks_csv(record.rectification))
    if record.correction is not None:
        write_tum(record.correction.found.corrected, folder / CORRECTED_FILE)
        write_text(folder / JUDGED_FILE, judged_csv(record.correction))
    (track,) = (track for track in passage.tracks if track.odometry == record.odometry)
    if record.kept_map is None:
        discard_map(folder / MAP_FOLDER)
    # Unless the map folder holds it.
    if record.map is not None and track.localizer.map is not None and kept_surfels(track) is None:
        save_map(track.localizer.map, folder / MAP_FILE)
    _write_json(metrics_of(record, passage, source, records), folder / METRICS_FILE)


def status_csv(record: RunRecord) -> str:
    """One row for each frame or reading."""
    head = ["stamp_s", "status", "reason", "matches", "inliers", "time_ms", "flags", "note", "dropped", "left_out"]
    rows: list[list[object]] = []
    dropped = [frame.overtaken + frame.is_unread for frame in record.frames]
    if dropped and record.drops is not None:
        dropped[-1] += record.drops.total - sum(dropped)  # those after it, and those that never became a frame
    left_out = [""] * len(record.frames)
    if left_out:  # of the recording as a whole: which row it was before is not known
        left_out[-1] = "; ".join(f"{count} of {of}: {why}" for why, (count, of) in record.left_out.items())
    for frame, lost, gone in zip(record.frames, dropped, left_out, strict=True):
        counts = (frame.matches, frame.inliers, f"{1e3 * frame.seconds:.3f}")
        answer = words.stamp(frame.stamp_s), frame.status, frame.reason or ""
        rows.append([*answer, *counts, ";".join(frame.flags), frame.note, lost, gone])
    return words.csv_text(head, rows)


def _forget(path: Path) -> None:
    """Remove a file of an earlier run, if it exists."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise output_error(error, path) from error


def _write_json(figures: dict[str, Any], path: Path) -> None:
    write_text(path, json.dumps(figures, indent=2, allow_nan=False) + "\n")
