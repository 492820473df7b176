"""The record of a finished track: its trajectory and its errors against the truth. Writes the map folder for the next
drive, too.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.app.run.kernels import InRealTime
from wheelsight.app.run.loops import MatchesOfRun, correction_of
from wheelsight.app.run.maps import map_record_of
from wheelsight.app.run.places import PlacesOfRun, rectification_of
from wheelsight.app.run.run_record import KeptMapRecord, KnownMapRecord, MapRecord, RunRecord
from wheelsight.app.run.run_source import format_of
from wheelsight.app.run.track import UNITS, Passage, RunTrack, has_map
from wheelsight.config import Config
from wheelsight.core.errors import CalibrationError, EvaluationError
from wheelsight.core.geometry import se3
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import Evaluation, evaluate
from wheelsight.io.recordings import Recording, express_for
from wheelsight.io.recordings.recording import HasWheelFaults, left_out_of
from wheelsight.slam.maps import DRIVE, MAP_FOLDER, MapFolder, MapWriter, discard_map
from wheelsight.slam.maps.folder import SURFELS_FILE


def records_of(
    passage: Passage,
    source: EventSource,
    config: Config,
    places: PlacesOfRun | None,
    matches: MatchesOfRun | None = None,
) -> tuple[RunRecord, ...]:
    """The record of each track of a finished pass."""
    for track in passage.tracks:
        if track.localizer.loops is not None and not passage.is_torn:
            track.localizer.loops.finish()  # first: keyframes, and all that hangs on them, move once more
    records = {track.odometry: _record_of(track, passage, source, config) for track in passage.tracks}
    if matches is not None:
        for track in passage.tracks:
            records[track.odometry] = _with_correction(records[track.odometry], track, config, matches)
    if places is not None:
        record = records["rectified"]
        wheels = records["wheels"]
        (wheel_track,) = (wheel_track for wheel_track in passage.tracks if wheel_track.odometry == "rectified")
        way = config.places.rectify or ""
        looks = tuple(sorted(wheel_track.looks, key=lambda look: look.stamp_s))
        found = rectification_of(places, way, looks, wheels.estimate, record.estimate, record.ground_truth)
        warnings = (places.start, *record.warnings) if places.is_start_true else record.warnings
        records["rectified"] = replace(record, rectification=found, warnings=warnings)
    return tuple(records.values())


def _with_correction(record: RunRecord, track: RunTrack, config: Config, matches: MatchesOfRun) -> RunRecord:
    def judge(corrected: Trajectory) -> Evaluation | None:
        truth = record.ground_truth
        return None if truth is None else _compare(corrected, truth, config, track)[0]

    correction, warnings = correction_of(matches, track.localizer, record.estimate, judge)
    return replace(record, correction=correction, warnings=(*record.warnings, *warnings))


def _record_of(track: RunTrack, passage: Passage, source: EventSource, config: Config) -> RunRecord:
    estimate = track.poses.trajectory(track.localizer.body, track.localizer.frame)
    truth, evaluation = None, None
    problem: str | None = "the live source has no ground truth"
    if isinstance(source, Recording):
        problem = "the recording has no ground truth"
        if source.ground_truth is not None:
            try:
                truth = express_for(track.localizer.body, source.ground_truth, source.calibration)
            except CalibrationError as error:
                problem = f"ground truth: {error}"
    if truth is not None:
        evaluation, problem = _compare(estimate, truth, config, track)
    surfels, kept = _maps(track, passage, source)
    has_faults = "wheels" in track.odometry and isinstance(source, HasWheelFaults)
    wheel_faults = source.wheel_faults if has_faults else ()  # type: ignore[attr-defined]
    return RunRecord(
        recording=source.name,
        format=format_of(source),
        frames=tuple(track.frames),
        estimate=estimate,
        odom=track.poses.odom(track.localizer.body),
        ground_truth=truth,
        evaluation=evaluation,
        association=source.association if isinstance(source, Recording) else None,
        warnings=(
            *source.warnings,
            *passage.unused,
            *track.localizer.warnings,
            *_warnings(track, passage, config, evaluation),
            *(() if kept is None else kept.warnings),
        ),
        evaluation_problem=problem,
        pictures=tuple(track.photographer.pictures),
        stage_seconds={stage: float(np.median(spent)) for stage, spent in track.stage_seconds.items()},
        config=config.to_dict(),
        peak_memory_mb=_peak_memory_mb(),
        unit=UNITS[track.odometry],
        odometry=track.odometry,
        map=surfels,
        kept_map=kept,
        realtime=source.report() if isinstance(source, InRealTime) else None,
        faults=(*wheel_faults, *track.localizer.warnings),
        known_map=_known_map(track, passage, config),
        is_interrupted=passage.interruption is not None,
        left_out=left_out_of(source.warnings),
    )


def _known_map(track: RunTrack, passage: Passage, config: Config) -> KnownMapRecord | None:
    """Whether and where the run was recognised in the known map; None without one."""
    localizer, given = track.localizer, config.known_map
    if localizer.recognised is None or localizer.loops is None or given.path is None or passage.is_torn:
        return None
    closed = localizer.loops.finish()
    kept = sum(loop.first < closed.known <= loop.second for loop in closed.loops.kept)
    record = KnownMapRecord(
        given.path,
        views=max(localizer.recognised, kept),
        keyframes=len(closed.is_in_map),
        keyframes_placed=int(np.count_nonzero(closed.is_in_map)),
        has_start=given.start is not None,
    )
    found = track.found
    if found is None or found.T_odom_body is None or not track.frames:
        return record
    T_odom_map = np.eye(4) if found.T_map_odom is None else found.T_map_odom
    T, C = T_odom_map @ found.T_odom_body, found.covariance_map
    x_m, y_m, z_m = T[:3, 3].tolist()
    sigma_m = sigma_rad = None
    if C is not None:
        blocks = se3.position_covariance(T, C), C[3:, 3:]
        sigma_m, sigma_rad = (float(np.sqrt(max(np.linalg.eigvalsh(block)[-1], 0.0))) for block in blocks)
    return replace(
        record,
        after_s=max(float(found.stamp_s - track.frames[0].stamp_s), 0.0),
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        yaw_rad=float(np.arctan2(T[1, 0], T[0, 0])) if localizer.body == "base" else None,
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
    )


def _maps(track: RunTrack, passage: Passage, source: EventSource) -> tuple[MapRecord | None, KeptMapRecord | None]:
    """The records of the track's surfel map and of its map folder."""
    if track.localizer.map is None or passage.is_torn:
        surfels = None
    else:
        track.localizer.map.settle()
        if track.localizer.loops is None:
            track.stops.lay(track.localizer.map)
        else:
            track.stops.follow(track.localizer.loops.finish())
        way = (track.stops.found, np.array(track.stops.T_map_body, float).reshape(-1, 4, 4))
        surfels = map_record_of(track.localizer.map, *way, source.calibration)
    kept = finish_map(track, passage)  # after the map was laid where the trajectory has it
    at = kept_surfels(track)
    if surfels is not None and at is not None:
        surfels = replace(surfels, file=f"{at.parent.name}/{at.name}")
    return surfels, kept


def _warnings(track: RunTrack, passage: Passage, config: Config, evaluation: Evaluation | None) -> Iterator[str]:
    """Warnings about an interruption, repeated images, the evaluation, and an incomplete or missing map."""
    if passage.interruption is not None:
        why = "by the user" if isinstance(passage.interruption, KeyboardInterrupt) else f"by {passage.interruption}"
        of_all = f" of {track.listed}" if track.listed else ""  # a live source has no known count
        yield f"Interrupted {why} after {len(track.frames)}{of_all} {UNITS[track.odometry]}s."
    if count := sum(frame.is_repeat for frame in track.frames):
        repeats = f"{count} of {len(track.frames)} listed frames show the same image as the frame before"
        yield f"{repeats} and were skipped: fewer images a second were taken than were recorded."
    yield from () if evaluation is None else evaluation.warnings
    surfel_map = track.localizer.map
    if surfel_map is not None and passage.is_torn:
        yield "The map was not kept: it was broken off in the middle of a frame."
    elif surfel_map is not None and surfel_map.dropped:
        yield (
            f"The map had no room for all that was seen: {surfel_map.dropped:,} surfels were given up, the least "
            f"useful first. surfels.max_surfels is {config.surfels.max_surfels:,}."
        )


def _compare(
    estimate: Trajectory, truth: Trajectory, config: Config, track: RunTrack
) -> tuple[Evaluation | None, str | None]:
    """The evaluation, or the reason why there is none."""
    frames = [frame for frame in track.frames if not frame.is_repeat]
    if not frames:
        return None, "no frames are listed, so no share of them can have a pose"
    share = sum(frame.has_pose for frame in frames) / len(frames)
    try:
        found = evaluate(estimate, truth, **config.evaluation.model_dump())
    except EvaluationError as error:
        return None, str(error)
    return replace(found, frames_with_pose=share), None


def _peak_memory_mb() -> float | None:
    """Peak memory of this process; None where the system does not report it."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)


@contextmanager
def keeping_maps(
    tracks: Sequence[RunTrack], source: EventSource, config: Config, folder: Path, known: MapFolder | None = None
) -> Iterator[None]:
    """Write the map of each track that leaves one, while the block runs. The map is valid however the block ends.

    The map of an earlier run in the same place is removed. A drive in a known map extends that map or leaves none.

    Raises:
        OutputError: the folder cannot be made, or holds something else.
        MapError: another run writes it.
    """
    try:
        for track in tracks:
            if known is not None:
                store = track.localizer.keyframes
                if (
                    config.known_map.extend
                    and store is not None
                    and has_map(track.odometry, [one.odometry for one in tracks])
                ):
                    track.map_writer, track.map_path, track.extends = MapWriter(known, store), known.path, True
            elif (
                track.localizer.keyframes is not None
                and has_map(track.odometry, [one.odometry for one in tracks])
                and (track.localizer.map is not None if config.sessions.keep_map is None else config.sessions.keep_map)
            ):
                path = (folder if len(tracks) == 1 else folder / track.odometry) / MAP_FOLDER
                keyframes = track.localizer.keyframes
                discard_map(path)
                factor = config.recording.depth_factor
                how: dict[str, Any] = {"source": source.name, "depth_factor": factor, "unfinished": DRIVE}
                kept = MapFolder.create(path, source.calibration, config.sessions, **how)
                # A track that closes loops computes the recognition codes itself.
                recognition = config.recognition if track.localizer.loops is None else None
                track.map_writer, track.map_path = MapWriter(kept, keyframes, recognition), path
        yield
    finally:
        for track in tracks:
            if track.map_writer is not None and track.map_path is not None:
                track.map_writer.close()
                if _is_empty(track.map_writer) and not track.extends:
                    discard_map(track.map_path)
        if known is not None:
            known.close()


def finish_map(track: RunTrack, passage: Passage) -> KeptMapRecord | None:
    """Finish the map of a track, if it has one. A run that was interrupted within a frame writes no surfels."""
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
            # Add to the known map the keyframes with a known place in it. Edges of other keyframes are left out: their
            # numbers go to the keyframes of the next drive.
            if closed.is_joined:
                writer.update(None)  # those of a place that was recognised when the drive was over
            writer.add_edges([edge for edge in closed.edges if closed.known <= edge.second < writer.taken])
            is_whole = writer.taken == len(closed.T_map_keyframe)
        else:
            writer.add_edges(closed.edges)
            is_whole = True
        writer.close(surfels, loops.recognizer if is_whole else None)
    if _is_empty(writer) and not track.extends:
        discard_map(path)
        return None
    size = 0
    with suppress(OSError):  # the disk is gone; the writer has reported it
        size = sum(file.stat().st_size for file in path.iterdir() if file.is_file())
    return KeptMapRecord(path.name, writer.keyframes, size, writer.warnings)


def _is_empty(writer: MapWriter) -> bool:
    """Whether the drive has no keyframes, and no write failed."""
    return not writer.keyframes and not writer.warnings


def kept_surfels(track: RunTrack) -> Path | None:
    """The path of the track's surfels in its map folder; None without surfels of this run."""
    if track.map_path is None or track.extends:
        return None
    path = track.map_path / SURFELS_FILE
    return path if path.is_file() else None
