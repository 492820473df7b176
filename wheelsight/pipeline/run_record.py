"""RunRecord: all that one run learned, as the metrics file and a report take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from wheelsight.estimates import Reason, Status
from wheelsight.evaluation import Evaluation
from wheelsight.geometry import BoolArray, ByteArray, FloatArray
from wheelsight.pipeline import words
from wheelsight.pipeline.kept_map_record import KeptMapRecord, KnownMapRecord
from wheelsight.pipeline.loops import CorrectionRecord
from wheelsight.pipeline.map_record import MapRecord
from wheelsight.pipeline.realtime_record import RealTimeRecord
from wheelsight.pipeline.rectification_record import RectificationRecord
from wheelsight.recordings import AssociationReport
from wheelsight.trajectory import Trajectory

_POSED = (Status.TRACKING, Status.COASTING)


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """One frame or wheel reading of a run: what was answered, and how long it took (image decoding not included).

    Attributes:
        index, stamp_s: of the frame or reading.
        status, reason, matches, inliers: of the answer.
        seconds: that it took.
        note: what was wrong with it.
        surfels, surfels_dropped: of a run that builds a map, how many it had then, and had given up for want of room.
        flags: of joined sensors, words such as "slip" that say more than the status.
        told_s: the stamp of the pose it was answered with; later than the frame's where newer readings were known.
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
    told_s: float | None = None
    overtaken: int = 0
    is_unread: bool = False

    @property
    def has_pose(self) -> bool:
        """Whether it was answered with a pose; where newer readings were known by then, with theirs, at `pose_s`.

        This is what report, terminal and metrics.json mean by "with a pose".
        """
        return self.status in _POSED and not self.is_repeat and (self.told_s is not None or not self.is_skipped)

    @property
    def pose_s(self) -> float:
        """The stamp at which the trajectory has its pose, if it has one."""
        return self.stamp_s if self.told_s is None else self.told_s

    @property
    def is_skipped(self) -> bool:
        """Whether the frame was listed but could not be used, so that odometry never judged it."""
        return self.reason is Reason.FRAME_UNUSABLE or self.is_repeat

    @property
    def is_repeat(self) -> bool:
        """Whether its image had come before, so that it is no frame but one listed twice."""
        return self.reason is Reason.REPEATED

    @property
    def why(self) -> str:
        """Why it gave no motion, as exactly as that is known; "" where it gave one."""
        if self.reason is None:
            return ""
        is_said = self.is_skipped or self.reason is Reason.TOO_LITTLE_DEPTH
        return self.note if self.note and is_said else str(self.reason)


@dataclass(frozen=True, slots=True)
class FrameDrops:
    """Frames that were taken and not used: the one count that info, terminal, status.csv, metrics.json and report show.

    An image that is listed twice counts once.

    Attributes:
        came: how many frames there were, dropped ones included.
        unpaired: colour without depth, or depth without colour, whichever is less.
        unreadable: listed frames that could not be read.
        overtaken: in real time, those for which a newer one came first, and those that the live camera lost.
        undecoded: how many of the overtaken ones were not even decoded.
    """

    came: int = 0
    unpaired: int = 0
    unreadable: int = 0
    overtaken: int = 0
    undecoded: int = 0

    @property
    def total(self) -> int:
        """How many were dropped."""
        return self.unpaired + self.unreadable + self.overtaken

    @property
    def share(self) -> float:
        """Of all that came, 0 to 1."""
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
    """Two frames with the point pairs that joined them.

    Attributes:
        stamp_s: of the current frame, seconds.
        reference_stamp_s: of the reference frame, seconds.
        color: (H, W, 3) uint8, red green blue.
        reference_color: likewise.
        px: matched pixels (N, 2) in the current image.
        reference_px: their partners (N, 2) in the reference image.
        is_inlier: (N,) which pairs agree with the motion found.
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
        peak_memory_mb: of the whole process, or None where the system does not tell.
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
        """Frames that were not used, as far as the run came; None of wheel readings."""
        if self.unit == "reading":
            return None
        unpaired = 0 if self.association is None or self.is_interrupted else self.association.unpaired
        overtaken, undecoded = (0, 0) if self.realtime is None else (self.realtime.dropped, self.realtime.unread)
        listed = sum(not frame.is_repeat for frame in self.frames)
        unreadable = sum(frame.is_unread for frame in self.frames)
        return FrameDrops(listed + unpaired + overtaken, unpaired, unreadable, overtaken, undecoded)

    @property
    def posed(self) -> int:
        """How many of `frames` have a pose."""
        return sum(frame.has_pose for frame in self.frames)

    def seconds_since_start(self, stamps_s: Sequence[float] | FloatArray) -> FloatArray:
        """Stamps (N,) as seconds after the first of `frames`."""
        start_s = self.frames[0].stamp_s if self.frames else 0.0
        return np.asarray(stamps_s, float) - start_s

    def frame_spans_s(self) -> tuple[FloatArray, FloatArray]:
        """From when (N,) to when (N,) each frame's answer holds, in seconds since the first: till the next frame."""
        starts_s = self.seconds_since_start([frame.stamp_s for frame in self.frames])
        steps_s = np.diff(starts_s)
        last_s = float(np.median(steps_s)) if len(steps_s) else 1.0
        return starts_s, starts_s + np.append(steps_s, last_s)[: len(starts_s)]

    @property
    def is_planar(self) -> bool:
        """Whether the estimate keeps to one plane, as wheels do."""
        return self.unit == "reading" or self.rectification is not None

    @property
    def is_joined(self) -> bool:
        """Whether it is by wheels and a camera together, so that a frame without a motion may have a pose."""
        return self.odometry == "joined"
