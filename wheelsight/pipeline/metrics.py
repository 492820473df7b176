"""All figures of a run with the unit in each name, as metrics.json holds them."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from wheelsight._version import __version__
from wheelsight.pipeline.joined import JoinedFacts, best_alone_of, facts_of, joined_of
from wheelsight.pipeline.map_record import MapRecord
from wheelsight.pipeline.origin import format_of, frame_count_of, path_of, wheel_count_of
from wheelsight.pipeline.rectification_record import RectificationRecord
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.pipeline.track import Passage
from wheelsight.pipeline.verdict import verdict_of, verdict_of_run
from wheelsight.sources import EventSource


def metrics_of(
    record: RunRecord, passage: Passage, source: EventSource, records: Sequence[RunRecord] = ()
) -> dict[str, Any]:
    """The figures of one odometry, and of the pass it was part of; `records` are those of all odometries."""
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
    """The figures of every odometry of one pass: what they share once, the rest below each one's name."""
    shared = [*source.warnings, *passage.unused]
    of_each = {
        record.odometry: {
            "frame": f"T_{record.estimate.frame}_{record.estimate.body}",
            **_of_odometry(record, passage, source, records),
            "warnings": [warning for warning in record.warnings if warning not in shared],
        }
        for record in records
    }
    return {
        "recording": _recording(source),
        "interrupted": passage.interruption is not None,
        "verdict": verdict_of_run(records).to_dict(),
        "elapsed_s": passage.elapsed_s,
        **_real_time(records[0]),
        "odometry": of_each,
        **_beside_alone(records),
        "peak_memory_mb": max((r.peak_memory_mb for r in records if r.peak_memory_mb is not None), default=None),
        "warnings": shared,
        "versions": _versions(),
    }


def _recording(source: EventSource) -> dict[str, str | None]:
    path = path_of(source)
    return {"name": source.name, "format": format_of(source), "path": None if path is None else str(path)}


def _real_time(record: RunRecord) -> dict[str, Any]:
    """How it went where the recording was played in real time."""
    return {} if record.realtime is None else {"realtime": record.realtime.to_dict()}


def _of_odometry(
    record: RunRecord, passage: Passage, source: EventSource, records: Sequence[RunRecord]
) -> dict[str, Any]:
    return {
        "verdict": verdict_of(record, records).to_dict(),
        "frames" if record.unit == "frame" else "wheel_readings": _frame_counts(record, source),
        "timing": _timing(record, passage),
        "trajectory": {"length_m": record.estimate.length_m, "duration_s": record.estimate.duration_s},
        "evaluation": None if record.evaluation is None else record.evaluation.to_dict(),
        "evaluation_problem": record.evaluation_problem,
        **({} if record.map is None else {"map": _map(record.map)}),
        **({} if record.rectification is None else {"rectification": _rectification(record.rectification)}),
        **({} if record.correction is None else {"loops": record.correction.to_dict()}),
        **({} if record.known_map is None else {"known_map": record.known_map.to_dict()}),
        **({} if record.kept_map is None else {"kept_map": record.kept_map.to_dict()}),
        **({"joined": _joined(facts_of(record))} if record.is_joined else {}),
    }


def _beside_alone(records: Sequence[RunRecord]) -> dict[str, Any]:
    """How joined sensors compare with the better one alone; nothing where none were joined."""
    if joined_of(records) is None:
        return {}
    best_alone = best_alone_of(records)
    return {
        "joined_beside_alone": None
        if best_alone is None
        else {"better": best_alone.odometry, "ate_ratio": best_alone.ratio}
    }


def _joined(facts: JoinedFacts) -> dict[str, Any]:
    """How long joined sensors were in each status, and whether their errors were as they stated."""
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
    """What areas did to the wheels: counts, shares of frames, and errors in the map, nothing aligned."""
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


def _map(found: MapRecord) -> dict[str, Any]:
    """How the map stands at the end."""
    status = asdict(found.status)
    return {"file": found.file, "frames_fused": found.fused, **status}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _frame_counts(record: RunRecord, source: EventSource) -> dict[str, Any]:
    frames = [frame for frame in record.frames if not frame.is_repeat]
    statuses = [str(frame.status) for frame in frames]
    reasons = [str(frame.reason) for frame in frames if frame.reason is not None]
    paired = record.association
    return {
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
    }


def _timing(record: RunRecord, passage: Passage) -> dict[str, Any]:
    """Times a frame or reading, image decoding not included; the first, which may compile kernels, stands apart.

    `elapsed_s` and the throughput are of the whole pass, which all its odometries share.
    """
    used_ms = [1e3 * frame.seconds for frame in record.frames if not frame.is_skipped]
    later_ms = used_ms[1:]
    return {
        "frame_median_ms": float(np.median(later_ms)) if later_ms else None,
        "frame_p95_ms": float(np.percentile(later_ms, 95)) if later_ms else None,
        "frame_max_ms": max(later_ms, default=None),
        "first_frame_ms": used_ms[0] if used_ms else None,
        "stages_median_ms": {stage: 1e3 * seconds for stage, seconds in record.stage_seconds.items()},
        "elapsed_s": passage.elapsed_s,
        "throughput_frames_per_s": len(record.frames) / passage.elapsed_s if passage.elapsed_s else None,
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
