"""From a recording to a folder of results: track, compare, write."""

from __future__ import annotations

import csv
import io
import json
import platform
import sys
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from wheelsight import __version__
from wheelsight.config import Config, save_config
from wheelsight.errors import CalibrationError, ConfigError, EvaluationError, WheelsightError
from wheelsight.estimates import Estimate
from wheelsight.evaluation import Evaluation, evaluate
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.files import make_output_folder, write_text
from wheelsight.geometry import ByteArray
from wheelsight.localizer import Localizer
from wheelsight.recordings import Recording, express_for
from wheelsight.report import FrameRecord, MatchPicture, RunRecord, write_report
from wheelsight.trajectory import Trajectory, write_tum


def run(
    recording: Recording,
    config: Config,
    out: Path,
    *,
    force: bool = False,
    on_frame: Callable[[FrameRecord], None] | None = None,
) -> RunRecord:
    """Track a whole recording and leave trajectory, status, metrics, configuration and report in the folder `out`.

    Ctrl-C, or a recording that breaks off, loses nothing: what was tracked until then is written and marked
    as interrupted, and then the exception goes on its way.

    Args:
        recording: from `open_recording`.
        config: all settings.
        out: folder for the results; made if need be.
        force: write into a folder that holds something already.
        on_frame: called after each frame, for a progress bar.

    Raises:
        ConfigError: the recording has no images, or no wheel readings, that the odometry asked for needs.
        CalibrationError: the calibration lacks its cameras, or its wheels.
        OutputError: `out` is not empty and `force` is off, or cannot be written; tried before the long work.
        RecordingError: the recording cannot be read on.
    """
    _check(recording, config)
    folder = make_output_folder(out, force)
    track = _track(recording, config, on_frame)
    record = _record(recording, config, track)
    _write(record, track, recording, config, folder)
    if track.interruption is not None:
        raise track.interruption
    return record


def _check(recording: Recording, config: Config) -> None:
    """Refuse what cannot end well, before anything is written."""
    if config.odometry == "wheels" and not recording.wheel_count:
        raise ConfigError(f"{recording.path}: the recording has no wheel readings", fix="--odometry features")
    if config.odometry == "features" and recording.wheel_count and not recording.frame_count:
        raise ConfigError(f"{recording.path}: the recording has no images", fix="--odometry wheels")
    Localizer(recording.calibration, config)


@dataclass
class _Track:
    """What the way through the recording gathered."""

    frames: list[FrameRecord] = field(default_factory=list)
    poses: list[Estimate] = field(default_factory=list)
    pictures: list[MatchPicture] = field(default_factory=list)
    stage_seconds: dict[str, list[float]] = field(default_factory=dict)
    body: str = "camera"
    world: str = "world"
    elapsed_s: float = 0.0
    interruption: BaseException | None = None


def _track(recording: Recording, config: Config, on_frame: Callable[[FrameRecord], None] | None) -> _Track:
    localizer = Localizer(recording.calibration, config)
    photographer = _Photographer(config.report.pictures, recording.frame_count)
    track = _Track(pictures=photographer.pictures, body=localizer.body, world=localizer.world)
    started = time.perf_counter()
    events = recording.events()
    try:
        for event in events:
            _step(localizer, event, track, photographer, on_frame)
    except (KeyboardInterrupt, WheelsightError) as interruption:
        track.interruption = interruption
    finally:
        if isinstance(events, Generator):
            events.close()  # stops the reader's thread
    track.elapsed_s = time.perf_counter() - started
    return track


def _step(
    localizer: Localizer,
    event: Event,
    track: _Track,
    photographer: _Photographer,
    on_frame: Callable[[FrameRecord], None] | None,
) -> None:
    started = time.perf_counter()
    estimate = localizer.process(event)
    seconds = time.perf_counter() - started
    if estimate is None:
        return
    if estimate.T_world_body is not None and estimate.reason is None:
        track.poses.append(estimate)
    if isinstance(event, RgbdFrame) and not localizer.note:
        photographer.look(event, estimate, localizer.last_matches)
        for stage, spent in localizer.stage_seconds.items():
            track.stage_seconds.setdefault(stage, []).append(spent)
    outcome = (estimate.status, estimate.reason, estimate.matches, estimate.inliers)
    index = event.index if isinstance(event, RgbdFrame | SkippedFrame) else len(track.frames)
    frame = FrameRecord(index, estimate.stamp_s, *outcome, seconds, localizer.note)
    track.frames.append(frame)
    if on_frame is not None:
        on_frame(frame)


class _Photographer:
    """Takes a few pictures of matched frames, evenly spread over the recording, keeping hardly any image meanwhile."""

    def __init__(self, wanted: int, frame_count: int) -> None:
        self.pictures: list[MatchPicture] = []
        self._due = [int((number + 0.5) * frame_count / wanted) for number in range(wanted)]
        self._images: dict[float, ByteArray] = {}

    def look(self, frame: RgbdFrame, estimate: Estimate, matches: Any) -> None:
        if not self._due or estimate.T_world_body is None:
            return
        kept, self._images = self._images, {frame.stamp_s: frame.color}
        if matches is None or matches.reference_stamp_s not in kept:
            return
        reference_s = float(matches.reference_stamp_s)
        reference = kept[reference_s]
        self._images[reference_s] = reference  # only it and this frame can be the next frame's reference
        if frame.index >= self._due[0]:
            pairs = (matches.px, matches.reference_px, matches.is_inlier)
            self.pictures.append(MatchPicture(frame.stamp_s, reference_s, frame.color, reference, *pairs))
            self._due = [index for index in self._due if index > frame.index]


def _record(recording: Recording, config: Config, track: _Track) -> RunRecord:
    estimate = _trajectory(track)
    truth, problem = _truth(recording, track)
    evaluation = None
    if truth is not None:
        evaluation, problem = _compare(estimate, truth, config, track)
    warnings = recording.warnings
    if track.interruption is not None:
        why = "by the user" if isinstance(track.interruption, KeyboardInterrupt) else f"by {track.interruption}"
        listed = f"{_listed(recording, config)} {_unit(config)}s"
        warnings += (f"Interrupted {why} after {len(track.frames)} of {listed}.",)
    return RunRecord(
        recording=recording.name,
        format=recording.format,
        frames=tuple(track.frames),
        estimate=estimate,
        ground_truth=truth,
        evaluation=evaluation,
        association=recording.association,
        warnings=warnings,
        evaluation_problem=problem,
        pictures=tuple(track.pictures),
        stage_seconds={stage: float(np.median(spent)) for stage, spent in track.stage_seconds.items()},
        config=config.to_dict(),
        peak_memory_mb=_peak_memory_mb(),
        unit=_unit(config),
    )


def _unit(config: Config) -> Literal["frame", "reading"]:
    return "reading" if config.odometry == "wheels" else "frame"


def _listed(recording: Recording, config: Config) -> int:
    return recording.wheel_count if config.odometry == "wheels" else recording.frame_count


def _trajectory(track: _Track) -> Trajectory:
    poses = track.poses
    covariances = [estimate.covariance for estimate in poses]
    return Trajectory(
        np.array([estimate.stamp_s for estimate in poses], float),
        np.array([estimate.T_world_body for estimate in poses], float).reshape(-1, 4, 4),
        None if not poses or any(c is None for c in covariances) else np.array(covariances, float),
        body=track.body,
        world=track.world,
    )


def _truth(recording: Recording, track: _Track) -> tuple[Trajectory | None, str | None]:
    """The ground truth of the body that was followed, or why there is none."""
    if recording.ground_truth is None:
        return None, "the recording has no ground truth"
    try:
        return express_for(track.body, recording.ground_truth, recording.calibration), None
    except CalibrationError as error:
        return None, f"ground truth: {error}"


def _compare(
    estimate: Trajectory, truth: Trajectory, config: Config, track: _Track
) -> tuple[Evaluation | None, str | None]:
    """The evaluation, or why there is none."""
    stamps_s = [frame.stamp_s for frame in track.frames]
    try:
        return evaluate(estimate, truth, frame_stamps_s=stamps_s, **config.evaluation.model_dump()), None
    except EvaluationError as error:
        return None, str(error)


def _write(record: RunRecord, track: _Track, recording: Recording, config: Config, folder: Path) -> None:
    save_config(config, folder / "config.yaml")
    write_tum(record.estimate, folder / "trajectory.txt")
    write_text(folder / "status.csv", _status_csv(record))
    metrics = json.dumps(_metrics(record, track, recording), indent=2, allow_nan=False)
    write_text(folder / "metrics.json", metrics + "\n")
    write_report(record, folder / "report.html")


def _status_csv(record: RunRecord) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["stamp_s", "status", "reason", "matches", "inliers", "time_ms", "note"])
    for frame in record.frames:
        counts = (frame.matches, frame.inliers, f"{1e3 * frame.seconds:.3f}")
        stamp = np.format_float_positional(
            frame.stamp_s, min_digits=6
        )  # as in trajectory.txt, so that rows can be joined
        rows.writerow([stamp, frame.status, frame.reason or "", *counts, frame.note])
    return text.getvalue()


def _metrics(record: RunRecord, track: _Track, recording: Recording) -> dict[str, Any]:
    """All figures of the run with the unit in each name, as metrics.json holds them."""
    return {
        "recording": {"name": record.recording, "format": record.format, "path": str(recording.path)},
        "frame": f"T_{record.estimate.world}_{record.estimate.body}",
        "interrupted": track.interruption is not None,
        "frames" if record.unit == "frame" else "wheel_readings": _frame_counts(record, recording),
        "timing": _timing(record, track),
        "trajectory": {"length_m": record.estimate.length_m, "duration_s": record.estimate.duration_s},
        "evaluation": None if record.evaluation is None else record.evaluation.to_dict(),
        "evaluation_problem": record.evaluation_problem,
        "peak_memory_mb": record.peak_memory_mb,
        "warnings": list(record.warnings),
        "versions": _versions(),
    }


def _frame_counts(record: RunRecord, recording: Recording) -> dict[str, Any]:
    frames = record.frames
    statuses = [str(frame.status) for frame in frames]
    reasons = [str(frame.reason) for frame in frames if frame.reason is not None]
    return {
        "listed": recording.frame_count if record.unit == "frame" else recording.wheel_count,
        "processed": len(frames),
        "with_pose": len(record.estimate),
        "with_pose_share": len(record.estimate) / len(frames) if frames else 0.0,
        "skipped": sum(frame.is_skipped for frame in frames),
        "dropped_color_images": record.association.dropped_color,
        "dropped_depth_images": record.association.dropped_depth,
        "status": {status: statuses.count(status) for status in sorted(set(statuses))},
        "reasons": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
    }


def _timing(record: RunRecord, track: _Track) -> dict[str, Any]:
    """Times a frame or reading, image decoding not included; the first, which may compile kernels, stands apart."""
    used_ms = [1e3 * frame.seconds for frame in record.frames if not frame.is_skipped]
    later_ms = used_ms[1:]
    return {
        "frame_median_ms": float(np.median(later_ms)) if later_ms else None,
        "frame_p95_ms": float(np.percentile(later_ms, 95)) if later_ms else None,
        "frame_max_ms": max(later_ms, default=None),
        "first_frame_ms": used_ms[0] if used_ms else None,
        "stages_median_ms": {stage: 1e3 * seconds for stage, seconds in record.stage_seconds.items()},
        "elapsed_s": track.elapsed_s,
        "throughput_frames_per_s": len(record.frames) / track.elapsed_s if track.elapsed_s else None,
    }


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


def _peak_memory_mb() -> float | None:
    """Of this process so far; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)
