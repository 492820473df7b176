"""`wheelsight info`: the contents of a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING, Annotated

import typer

from wheelsight.app.cli.options import (
    CalibrationFile,
    Camera,
    DepthFactor,
    MaxGap,
    RateHz,
    RecordingPath,
    Topics,
    open_source,
    settings_from,
)

if TYPE_CHECKING:
    from wheelsight.app.run import FrameDrops
    from wheelsight.evaluation import SequenceStatistics
    from wheelsight.io.recordings import RecordedTopic
    from wheelsight.io.recordings.inspection import ClockMapping, Inspection


_GAPS_SHOWN = 5


def info(
    recording: RecordingPath,
    camera: Camera = None,
    calibration: CalibrationFile = None,
    depth_factor: DepthFactor = None,
    max_gap: MaxGap = None,
    rate_hz: RateHz = None,
    topic: Topics = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> None:
    """Show what is in a recording, and what to know before trusting results made from it.

    Every image and reading is read once: rates, gaps, depth, registration, ground truth, and warnings.

    [bold]Examples[/bold]

    wheelsight info rgbd_dataset_freiburg1_desk
    wheelsight info my_recording --camera my_camera.yaml --json
    wheelsight info robot.bag --topic depth=/camera/depth/image_raw
    """
    from wheelsight.app.cli.console import console, facts_table, print_json, print_warning
    from wheelsight.app.cli.progress import FrameProgress
    from wheelsight.io.recordings.inspection import inspect_recording
    from wheelsight.wheels import gyro_warnings

    given = {"camera": camera, "calibration": calibration, "depth_factor": depth_factor}
    given |= {"max_gap_s": max_gap, "rate_hz": rate_hz, "topics": topic}
    config = settings_from({f"recording.{name}": value for name, value in given.items()})
    source = open_source(recording, config)
    with FrameProgress("reading", source.frame_count or source.wheel_count) as progress:
        inspection = inspect_recording(source, progress.advance)
        inspection = replace(inspection, warnings=(*inspection.warnings, *gyro_warnings(source)))
    if as_json:
        print_json({**inspection.to_dict(), "dropped": frame_drops(inspection).to_dict()})
        return
    stdout = console()
    stdout.print(facts_table(inspection.name, _facts(inspection)))
    if inspection.topics:
        stdout.print()
        stdout.print(facts_table("Topics", topic_facts(inspection.topics)))
    if inspection.ground_truth is not None:
        stdout.print()
        stdout.print(facts_table("Ground truth", truth_facts(inspection.ground_truth)))
    for warning in inspection.warnings:
        print_warning(warning)


def _facts(inspection: Inspection) -> Iterator[tuple[str, str]]:
    # One reading alone has no rate.
    rate = f", {inspection.rate_hz:.1f} Hz" if isfinite(inspection.rate_hz) else ""
    span = f" in {inspection.duration_s:.2f} s{rate}"
    yield "format", inspection.format
    yield "trajectory of", f"the {inspection.body} (T_map_{inspection.body})"
    if inspection.camera is not None:
        yield "camera", inspection.camera
    if inspection.wheels is not None:
        yield "wheels", inspection.wheels
    if inspection.frames:
        yield "frames", f"{inspection.frames}{span}"
    if inspection.wheel_readings:
        yield "wheel readings", f"{inspection.wheel_readings}{'' if inspection.frames else span}"
    if inspection.yaw_readings:
        yield "yaw rates", str(inspection.yaw_readings)
    longest = sorted(inspection.gaps, key=lambda gap: -gap.length_s)[:_GAPS_SHOWN]
    shown = ", ".join(f"{gap.length_s:.2f} s at {gap.start_s:.2f}" for gap in longest)
    more = ", …" if len(inspection.gaps) > _GAPS_SHOWN else ""
    gaps = f"{len(inspection.gaps)} over three periods: {shown}{more}"
    yield "gaps", gaps if inspection.gaps else "none over three periods"
    yield from _frame_facts(inspection) if inspection.frames else ()
    if inspection.clock is not None:
        yield from clock_facts(inspection.clock)
    for why, count, of in inspection.left_out:
        yield "left out", f"{count} of {of}: {why}"
    if (motion := inspection.motion) is not None:
        unknown = f"whether their clocks are apart is not known: {motion.why_not}"
        known = f"by their turns the camera's stamps are {motion}"
        yield "camera and wheels", unknown if motion.offset_s is None else known
    if inspection.ground_truth is None:
        yield "ground truth", "none"


def _frame_facts(inspection: Inspection) -> Iterator[tuple[str, str]]:
    from wheelsight.app.cli.console import percent

    association, depth_m, offset = inspection.association, inspection.depth_m, inspection.offset
    dropped = f"{association.dropped_color} and {association.dropped_depth} without a partner"
    counts = f"{association.color_images} colour, {association.depth_images} depth, {dropped}"
    yield "images", f"{counts}; at most {1e3 * association.largest_gap_s:.1f} ms apart"
    yield "dropped", frame_drops(inspection).sentence
    for reason, count in inspection.skipped:
        yield "unusable", f"{count} × {reason}"
    yield "valid depth", f"{percent(inspection.valid_depth_share)} of pixels"
    usual = f"5 to 95 % within {depth_m['p5']:.2f} to {depth_m['p95']:.2f} m"
    yield "depth", f"median {depth_m['median']:.2f} m, {usual}"
    joined = (
        "registered, by the calibration" if inspection.is_registered else "not registered; the calibration joins them"
    )
    checked = "too few edges to check" if offset is None else str(offset)
    if offset is not None and not offset.is_clear:
        checked = "the images agree with shared pixels"
    yield "registration", f"{joined}; {checked}"


def topic_facts(topics: Sequence[RecordedTopic]) -> Iterator[tuple[str, str]]:
    """Number of messages, type and use of each topic."""
    for topic in topics:
        used = f", used as {topic.used_as}" if topic.used_as else ""
        yield topic.name, f"{topic.count:,} × {topic.type.rpartition('/')[2]}{used}"


def clock_facts(clock: ClockMapping) -> Iterator[tuple[str, str]]:
    """The mapping of the camera's clock to the host's, with its uncertainty."""
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
    """Statistics of the ground truth."""
    from math import degrees

    yield "duration", f"{truth.duration_s:.2f} s"
    yield "with poses", f"{truth.posed_duration_s:.2f} s"
    yield "length", f"{truth.length_m:.3f} m; in steps of {truth.window_s:g} s {truth.windowed_length_m:.3f} m"
    yield "mean speed", f"{truth.mean_speed_m_per_s:.3f} m/s"
    yield "mean turning", f"{degrees(truth.mean_angular_speed_rad_per_s):.2f} °/s"
    yield "extent", " × ".join(f"{side:.2f}" for side in truth.extent_m) + " m"


def frame_drops(inspection: Inspection) -> FrameDrops:
    """The frames that a run cannot use, counted as a run counts them."""
    from wheelsight.app.run import FrameDrops
    from wheelsight.core.messages import NOTHING_MEASURED

    unreadable = sum(count for reason, count in inspection.skipped if reason != NOTHING_MEASURED)
    unpaired = inspection.association.unpaired
    return FrameDrops(inspection.frames - inspection.repeated + unpaired, unpaired, unreadable)
