"""RunRecord: the results of one run, for the metrics file and the report. Holds the records of its parts: real time,
map, map folders and areas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from wheelsight.app.run import words
from wheelsight.app.run.loops import CorrectionRecord
from wheelsight.core.areas import AreaMap
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import BoolArray, ByteArray, FloatArray, IntArray
from wheelsight.core.trajectory import Trajectory
from wheelsight.evaluation import Evaluation, Statistics
from wheelsight.io.recordings import AssociationReport
from wheelsight.mapping import MapStatus
from wheelsight.mapping.plan import MapCloud, MapPlan


@dataclass(frozen=True, slots=True)
class RealTimeRecord:
    """Number of answered and dropped frames, and latencies.

    Attributes:
        played_s: duration of the playback.
        frames: number of frames; each was answered or dropped.
        dropped: number of frames that a newer one overtook before they were processed.
        unread: number of dropped frames that were not decoded.
        readings: of wheels and gyroscope, all answered.
        latency_median_s, latency_p95_s: from a frame's stamp to its answer (without frames, a reading's); None without
            any.
        wheels_from: port, pipe or file of the wheel readings; None for the recording's own.
        is_live: whether the sensors were live.
        camera: name of the live camera, or None.
    """

    played_s: float
    frames: int
    dropped: int
    unread: int
    readings: int
    latency_median_s: float | None = None
    latency_p95_s: float | None = None
    wheels_from: str | None = None
    is_live: bool = False
    camera: str | None = None

    @property
    def answered_per_s(self) -> float:
        """Frames a second, or readings without frames."""
        answered = self.frames - self.dropped if self.frames else self.readings
        return answered / self.played_s if self.played_s > 0 else 0.0

    @property
    def dropped_share(self) -> float:
        """Share of dropped frames."""
        return self.dropped / self.frames if self.frames else 0.0

    @property
    def sentence(self) -> str:
        """Such as "played in real time: 29.8 frames/s answered, latency 31 ms median, 52 ms 95 %"."""
        how = "live" if self.is_live else "played in real time"
        parts = [f"{how}: {self.answered_per_s:.1f} {'frames' if self.frames else 'readings'}/s answered"]
        if self.latency_median_s is not None and self.latency_p95_s is not None:
            parts.append(f"latency {1e3 * self.latency_median_s:.0f} ms median, {1e3 * self.latency_p95_s:.0f} ms 95 %")
        return ", ".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """All figures, the unit in each name, latencies in milliseconds."""
        figures = asdict(self)
        late = {name: figures.pop(f"{name}_s") for name in ("latency_median", "latency_p95")}
        return {
            **figures,
            "answered_per_s": self.answered_per_s,
            "dropped_share": self.dropped_share,
            **{f"{name}_ms": None if seconds is None else 1e3 * seconds for name, seconds in late.items()},
        }


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """An image of the camera, and the finished map rendered from the same pose.

    Attributes:
        stamp_s: of the frame, seconds.
        color: (H, W, 3) uint8, red green blue: the frame's.
        rendered: (h, w, 3) uint8 likewise: the map's; white without surfels.
    """

    stamp_s: float
    color: ByteArray
    rendered: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class MapRecord:
    """A run's surfel map.

    Attributes:
        status: at the end.
        fused: number of fused frames.
        file: its name in the run's folder.
        plan: the map from above, or None if empty.
        pictures: views along the path.
        is_levelled: whether the calibration gives the vertical; otherwise the surfels do.
        cloud: a few points for the page, or None.
    """

    status: MapStatus
    fused: int
    file: str
    plan: MapPlan | None
    pictures: tuple[MapPicture, ...] = ()
    is_levelled: bool = True
    cloud: MapCloud | None = None

    @property
    def sentence(self) -> str:
        """Size of the map."""
        return f"{self.status.surfels:,} surfels, {self.status.stable:,} of them stable"


@dataclass(frozen=True, slots=True)
class KeptMapRecord:
    """The map folder of one track.

    Attributes:
        file: its name in the track's folder.
        keyframes: number of keyframes.
        bytes: of all its files.
        warnings: failed writes, with reasons.
    """

    file: str
    keyframes: int
    bytes: int
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {name: value for name, value in asdict(self).items() if name != "warnings"}

    @property
    def sentence(self) -> str:
        """Size of the map folder."""
        return f"{self.keyframes:,} keyframes, {self.bytes / 1e6:.1f} MB"


@dataclass(frozen=True, slots=True)
class KnownMapRecord:
    """The recognition of a drive in the map of an earlier one.

    Attributes:
        path: of the map's folder.
        after_s: seconds from the first frame to the first pose in the map; None without one during the drive.
        x_m, y_m, z_m, yaw_rad: that pose in the map; the heading is None for a camera alone.
        sigma_m, sigma_rad: one standard deviation along the worst direction, and of the rotation about the worst axis;
            None if unknown.
        views: number of recognitions until the end of the drive.
        keyframes, keyframes_placed: keyframes of this drive, and those of known position in the map.
        has_start: whether the user gave the start.
    """

    path: str
    after_s: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    yaw_rad: float | None = None
    sigma_m: float | None = None
    sigma_rad: float | None = None
    views: int = 0
    keyframes: int = 0
    keyframes_placed: int = 0
    has_start: bool = False

    @property
    def is_recognised(self) -> bool:
        """Whether the drive was recognised in the map."""
        return self.views > 0 and self.keyframes_placed > 0

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {**asdict(self), "is_recognised": self.is_recognised}

    @property
    def sentence(self) -> str:
        """Whether, when and where it was recognised, with the uncertainty."""
        if not self.is_recognised:
            if self.has_start:
                return f"The place was not recognised in the map {self.path}: poses rest on --start alone"
            return f"The place was not recognised in the map {self.path}: there are no poses in it"
        seen = f"{words.count(self.views, 'view')} of the map seen again"
        if self.after_s is None:
            return f"Recognised in the map {self.path} only after the drive: no pose on the way is in it; {seen}"
        where = f"x {self.x_m:.2f} m, y {self.y_m:.2f} m, "
        where += f"z {self.z_m:.2f} m" if self.yaw_rad is None else f"heading {math.degrees(self.yaw_rad):.0f}°"
        sure = "how surely is not known"
        if self.sigma_m is not None and self.sigma_rad is not None:
            sure = f"1σ {words.length(self.sigma_m)} and {words.angle(math.degrees(self.sigma_rad))}"
        after = words.duration(self.after_s)
        return f"Recognised in the map {self.path} after {after}, at {where} ({sure}); {seen}"


@dataclass(frozen=True, slots=True, eq=False)
class AreaObservation:
    """The area probabilities of one frame, and the belief after the update.

    Attributes:
        stamp_s: of the frame.
        probabilities: (A,) by the model, or None for a frame without a measurement.
        named: index of the most probable area by the model, -1 for none.
        belief: (A,) area probabilities by the filter, or None: the paper's way has none.
        trust: probability that the forest is reliable, NaN if unknown.
        note: why there is no measurement, or "".
    """

    stamp_s: float
    probabilities: FloatArray | None = None
    named: int = -1
    belief: FloatArray | None = None
    trust: float = float("nan")
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MapErrors:
    """Planar distances from the true base, without alignment, at frames where all paths are known.

    Attributes:
        stamps_s: (M,) of these frames, at least one.
        wheels_m: (M,) of the wheels alone.
        rectified_m: (M,) of the rectified path.
    """

    stamps_s: FloatArray
    wheels_m: FloatArray
    rectified_m: FloatArray

    @property
    def wheels(self) -> Statistics:
        """Of the wheels alone."""
        return Statistics.of(self.wheels_m)

    @property
    def rectified(self) -> Statistics:
        """Of the rectified path."""
        return Statistics.of(self.rectified_m)

    @property
    def left(self) -> float:
        """Mean error of the rectified path over that of the wheels; NaN if the wheels have no error."""
        return self.rectified.mean / self.wheels.mean if self.wheels.mean > 0 else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class RectificationRecord:
    """The results on areas for a report.

    Attributes:
        way: "probabilistic" or "paper".
        areas: in the map frame.
        looks: one for each frame, in order of time.
        wheels: the wheels alone, T_odom_base from the same start.
        start: how the start is known, in a sentence.
        true_areas: (N,) index of the true area at each look, -1 in none or unknown; None without ground truth.
        errors: in the map, or None without ground truth.
    """

    way: str
    areas: AreaMap
    looks: tuple[AreaObservation, ...]
    wheels: Trajectory
    start: str
    true_areas: IntArray | None = None
    errors: MapErrors | None = None

    @property
    def stamps_s(self) -> FloatArray:
        """(N,) of the looks."""
        return np.array([look.stamp_s for look in self.looks], float)

    @property
    def forest(self) -> FloatArray:
        """(N, A) the model's probabilities, rows of NaN where there is no measurement."""
        return self._rows([look.probabilities for look in self.looks])

    @property
    def belief(self) -> FloatArray | None:
        """(N, A) the filter's probabilities, rows of NaN before the first pose; None of the paper's way."""
        return self._rows([look.belief for look in self.looks]) if self.way == "probabilistic" else None

    @property
    def trust(self) -> FloatArray:
        """(N,) probability that the forest is reliable, NaN if unknown."""
        return np.array([look.trust for look in self.looks], float)

    @property
    def is_judged(self) -> BoolArray:
        """(N,) whether a look has a true area and is a measurement."""
        seen = np.array([look.probabilities is not None for look in self.looks], bool)
        return seen & (self.true_areas >= 0) if self.true_areas is not None else np.zeros(len(self.looks), bool)

    def accuracy(self, probabilities: FloatArray) -> float:
        """Share of judged looks whose most probable area (N, A) is the true one; NaN where none is judged."""
        which = self.is_judged & ~np.isnan(probabilities).any(axis=1)
        if self.true_areas is None or not which.any():
            return float("nan")
        return float((probabilities[which].argmax(axis=1) == self.true_areas[which]).mean())

    def _rows(self, rows: list[FloatArray | None]) -> FloatArray:
        nothing = np.full(len(self.areas), np.nan)
        found = [nothing if row is None else row for row in rows]
        return np.array(found, float).reshape(-1, len(self.areas))


_POSED = (Status.TRACKING, Status.COASTING, Status.UNCONFIRMED)


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """The answer to one frame or wheel reading, and its processing time (without image decoding).

    Attributes:
        index, stamp_s: of the frame or reading.
        status, reason, matches, inliers: of the answer.
        seconds: processing time.
        note: problem of the frame.
        surfels, surfels_dropped: size of the map, if there is one, and number of surfels removed to limit its memory.
        flags: of joined sensors, such as "slip".
        posed_s: stamp of the answered pose; later than the frame's if newer readings were known.
        overtaken: frames since the row before that were dropped in real time.
        is_unread: whether it was listed and could not be read.
    """

    index: int
    stamp_s: float
    status: Status
    reason: Reason | None
    matches: int
    inliers: int
    seconds: float
    note: str = ""
    surfels: int | None = None
    surfels_dropped: int = 0
    flags: tuple[str, ...] = ()
    posed_s: float | None = None
    overtaken: int = 0
    is_unread: bool = False

    @property
    def has_pose(self) -> bool:
        """Whether the answer has a pose; if newer readings were known, a pose at `pose_s`.

        Report, terminal and metrics.json use this as "with a pose".
        """
        return self.status in _POSED and not self.is_repeat and (self.posed_s is not None or not self.is_skipped)

    @property
    def pose_s(self) -> float:
        """Stamp of its pose in the trajectory, if it has one."""
        return self.stamp_s if self.posed_s is None else self.posed_s

    @property
    def is_skipped(self) -> bool:
        """Whether the frame was listed but not usable, so that odometry did not process it."""
        return self.reason is Reason.FRAME_UNUSABLE or self.is_repeat

    @property
    def is_repeat(self) -> bool:
        """Whether its image repeats an earlier one."""
        return self.reason is Reason.REPEATED

    @property
    def why(self) -> str:
        """The most specific reason for a missing motion; "" with a motion."""
        if self.reason is None:
            return ""
        is_said = self.is_skipped or self.reason is Reason.TOO_LITTLE_DEPTH
        return self.note if self.note and is_said else str(self.reason)


@dataclass(frozen=True, slots=True)
class FrameDrops:
    """Frames that were not used. Info, terminal, status.csv, metrics.json and report show this one count.

    An image that is listed twice counts once.

    Attributes:
        came: number of frames, with dropped ones.
        unpaired: colour without depth, or depth without colour, whichever is less.
        unreadable: listed frames that could not be read.
        overtaken: in real time, frames that a newer one overtook, and frames that the live camera lost.
        undecoded: number of overtaken frames that were not decoded.
    """

    came: int = 0
    unpaired: int = 0
    unreadable: int = 0
    overtaken: int = 0
    undecoded: int = 0

    @property
    def total(self) -> int:
        """Number of dropped frames."""
        return self.unpaired + self.unreadable + self.overtaken

    @property
    def share(self) -> float:
        """Share of dropped frames, 0 to 1."""
        return self.total / self.came if self.came else 0.0

    @property
    def sentence(self) -> str:
        """Such as "25 of 36 frames dropped (69.4 %): 25 without a partner"."""
        counts = ("without a partner", self.unpaired), ("unreadable", self.unreadable), ("overtaken", self.overtaken)
        causes = ", ".join(f"{count:,} {cause}" for cause, count in counts if count)
        text = f"{self.total:,} of {words.count(self.came, 'frame')} dropped"
        return f"{text} ({words.percent(self.share)}): {causes}" if causes else text

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json, and for `info --json`."""
        return {**asdict(self), "total": self.total, "share": self.share}


@dataclass(frozen=True, slots=True, eq=False)
class MatchPicture:
    """Two frames with their matched points.

    Attributes:
        stamp_s: of the current frame, seconds.
        reference_stamp_s: of the reference frame, seconds.
        color: (H, W, 3) uint8, red green blue.
        reference_color: likewise.
        px: matched pixels (N, 2) in the current image.
        reference_px: their partners (N, 2) in the reference image.
        is_inlier: (N,) which pairs agree with the estimated motion.
    """

    stamp_s: float
    reference_stamp_s: float
    color: ByteArray
    reference_color: ByteArray
    px: FloatArray
    reference_px: FloatArray
    is_inlier: BoolArray


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class RunRecord:
    """A finished run.

    Attributes:
        recording: the recording's name, or the live source's.
        format: its reader's name, or "live".
        frames: one record for each frame listed, skipped ones included; of wheel odometry, for each wheel reading.
        estimate: the trajectory; frames without a pose are not in it.
        odom: the same way in the frame that a controller follows, without the trajectory's leaps; None where that has
            none.
        ground_truth: or None.
        evaluation: against the ground truth, or None without one; `evaluation_problem` then says why.
        association: how colour and depth were paired, or None where a live source gives them as frames.
        warnings: about the recording, one sentence each.
        pictures: a few frames with their matches.
        stage_seconds: median time a frame of each stage (extract, match, align, …).
        config: the resolved configuration.
        peak_memory_mb: of the whole process, or None where the system does not report it.
        finished_at: when the run ended, with its time zone.
        unit: what `frames` holds, "frame" or "reading".
        odometry: its name, "rectified" of wheels that areas correct, or "joined" of wheels and a camera: then `frames`
            are of frames alone, while the trajectory has a pose at each wheel reading too.
        rectification: what areas did to the wheels, or None.
        map: what was built on the way, or None.
        correction: what matches from outside made of the trajectory, or None.
        realtime: how it went, if the recording was played in real time, or None.
        kept_map: the map folder that it leaves for the next drive, or None.
        faults: what was found wrong with sensors and their clocks on the way, one sentence each; also in `warnings`.
        known_map: whether and where it found itself in the map of an earlier drive, or None without one.
        is_interrupted: whether it ended before its recording.
        left_out: lines or messages of the recording that were not used: how many, and of how many, by reason.
    """

    recording: str
    format: str
    frames: tuple[FrameRecord, ...]
    estimate: Trajectory
    ground_truth: Trajectory | None
    evaluation: Evaluation | None
    association: AssociationReport | None
    warnings: tuple[str, ...] = ()
    evaluation_problem: str | None = None
    pictures: tuple[MatchPicture, ...] = ()
    stage_seconds: dict[str, float] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    peak_memory_mb: float | None = None
    finished_at: datetime = field(default_factory=lambda: datetime.now(UTC))
    unit: Literal["frame", "reading"] = "frame"
    odometry: str = "features"
    rectification: RectificationRecord | None = None
    map: MapRecord | None = None
    realtime: RealTimeRecord | None = None
    correction: CorrectionRecord | None = None
    kept_map: KeptMapRecord | None = None
    odom: Trajectory | None = None
    faults: tuple[str, ...] = ()
    known_map: KnownMapRecord | None = None
    is_interrupted: bool = False
    left_out: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def drops(self) -> FrameDrops | None:
        """Frames that were not used during the run; None for wheel readings."""
        if self.unit == "reading":
            return None
        unpaired = 0 if self.association is None or self.is_interrupted else self.association.unpaired
        overtaken, undecoded = (0, 0) if self.realtime is None else (self.realtime.dropped, self.realtime.unread)
        listed = sum(not frame.is_repeat for frame in self.frames)
        unreadable = sum(frame.is_unread for frame in self.frames)
        return FrameDrops(listed + unpaired + overtaken, unpaired, unreadable, overtaken, undecoded)

    @property
    def posed(self) -> int:
        """Number of `frames` with a pose."""
        return sum(frame.has_pose for frame in self.frames)

    def seconds_since_start(self, stamps_s: Sequence[float] | FloatArray) -> FloatArray:
        """Stamps (N,) as seconds after the first of `frames`."""
        start_s = self.frames[0].stamp_s if self.frames else 0.0
        return np.asarray(stamps_s, float) - start_s

    def frame_spans_s(self) -> tuple[FloatArray, FloatArray]:
        """Beginnings (N,) and ends (N,) of the time of each frame's answer, seconds since the first frame."""
        starts_s = self.seconds_since_start([frame.stamp_s for frame in self.frames])
        steps_s = np.diff(starts_s)
        last_s = float(np.median(steps_s)) if len(steps_s) else 1.0
        return starts_s, starts_s + np.append(steps_s, last_s)[: len(starts_s)]

    @property
    def is_planar(self) -> bool:
        """Whether the estimate stays in one plane, as with wheels."""
        return self.unit == "reading" or self.rectification is not None

    @property
    def is_joined(self) -> bool:
        """Whether wheels and a camera are joined, so that a frame without a motion may have a pose."""
        return self.odometry == "joined"
