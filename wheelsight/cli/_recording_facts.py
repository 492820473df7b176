"""What `wheelsight info` says of a bag's topics, of clocks, of ground truth, and of dropped frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wheelsight.evaluation import SequenceStatistics
    from wheelsight.pipeline import FrameDrops
    from wheelsight.recordings import RecordedTopic
    from wheelsight.recordings.clock_mapping import ClockMapping
    from wheelsight.recordings.inspection import Inspection


def topic_facts(topics: Sequence[RecordedTopic]) -> Iterator[tuple[str, str]]:
    """Each topic, how many messages of what type it has, and what it is used as."""
    for topic in topics:
        used = f", used as {topic.used_as}" if topic.used_as else ""
        yield topic.name, f"{topic.count:,} × {topic.type.rpartition('/')[2]}{used}"


def clock_facts(clock: ClockMapping) -> Iterator[tuple[str, str]]:
    """How the camera's clock was mapped to the host's, and how surely."""
    if clock.offset_s is None:
        yield "camera clock", "none: frames are stamped when they arrived"
    else:
        drift = "" if clock.drift_ppm is None else f", runs {clock.drift_ppm:+.0f} ppm fast"
        yield "camera clock", f"host time less {clock.offset_s:.6f} s{drift}"
    sigmas = f"σ {1e3 * clock.sigma_median_s:.2f} ms (median), {1e3 * clock.sigma_largest_s:.2f} ms at most"
    yield "its mapping", f"{sigmas}, of {clock.frames} frames"
    late = f"{1e3 * clock.arrival_median_s:.1f} ms (median), {1e3 * clock.arrival_p95_s:.1f} ms (95 %)"
    yield "arrival", f"{late} after the stamp; {clock.missing} numbers missing"


def truth_facts(truth: SequenceStatistics) -> Iterator[tuple[str, str]]:
    """Ground truth in figures."""
    from math import degrees

    yield "duration", f"{truth.duration_s:.2f} s"
    yield "with poses", f"{truth.posed_duration_s:.2f} s"
    yield "length", f"{truth.length_m:.3f} m; in steps of {truth.window_s:g} s {truth.windowed_length_m:.3f} m"
    yield "mean speed", f"{truth.mean_speed_m_per_s:.3f} m/s"
    yield "mean turning", f"{degrees(truth.mean_angular_speed_rad_per_s):.2f} °/s"
    yield "extent", " × ".join(f"{side:.2f}" for side in truth.extent_m) + " m"


def frame_drops(inspection: Inspection) -> FrameDrops:
    """The frames that a run cannot use, counted as a run counts them."""
    from wheelsight.events import NOTHING_MEASURED
    from wheelsight.pipeline import FrameDrops

    unreadable = sum(count for reason, count in inspection.skipped if reason != NOTHING_MEASURED)
    unpaired = inspection.association.unpaired
    return FrameDrops(inspection.frames - inspection.repeated + unpaired, unpaired, unreadable)
