"""One pass over a recording's events, answered by every odometry that was asked for."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from wheelsight.config import Config, OdometryName
from wheelsight.errors import WheelsightError
from wheelsight.estimates import Estimate
from wheelsight.events import Event, RgbdFrame, SkippedFrame
from wheelsight.geometry import ByteArray
from wheelsight.localizer import Localizer
from wheelsight.recordings import Recording
from wheelsight.report import FrameRecord, MatchPicture

UNITS: dict[OdometryName, Literal["frame", "reading"]] = {"features": "frame", "wheels": "reading"}


class Photographer:
    """Takes a few pictures of matched frames, evenly spread over the recording, keeping hardly any image meanwhile."""

    def __init__(self, wanted: int, frame_count: int) -> None:
        self.pictures: list[MatchPicture] = []
        self._due = [int((number + 0.5) * frame_count / wanted) for number in range(wanted)]
        self._images: dict[float, ByteArray] = {}

    def look(self, frame: RgbdFrame, estimate: Estimate, matches: Any) -> None:
        """Take a picture of `frame` if one is due and its reference is at hand."""
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


@dataclass
class Track:
    """One odometry's way through a recording: what it answered so far.

    Attributes:
        odometry: its name.
        listed: how many frames or readings of the recording it is to answer.
        localizer: what answers.
        photographer: what takes pictures.
        frames: a record of each answer.
        poses: the answers that have a pose of their own.
        stage_seconds: how long each stage of each frame took.
    """

    odometry: OdometryName
    listed: int
    localizer: Localizer
    photographer: Photographer
    frames: list[FrameRecord] = field(default_factory=list)
    poses: list[Estimate] = field(default_factory=list)
    stage_seconds: dict[str, list[float]] = field(default_factory=dict)

    @classmethod
    def begin(cls, odometry: OdometryName, recording: Recording, config: Config) -> Track:
        """At the start. Raises CalibrationError."""
        listed = recording.wheel_count if UNITS[odometry] == "reading" else recording.frame_count
        photographer = Photographer(config.report.pictures, recording.frame_count)
        return cls(odometry, listed, Localizer(recording.calibration, config.alone(odometry)), photographer)

    @property
    def needs_images(self) -> bool:
        """Whether it answers frames."""
        return RgbdFrame in self.localizer.answers

    def step(self, event: Event) -> FrameRecord | None:
        """Answer one event; None of one that is not its business."""
        localizer = self.localizer
        started = time.perf_counter()
        estimate = localizer.process(event)
        seconds = time.perf_counter() - started
        if estimate is None:
            return None
        if estimate.T_world_body is not None and estimate.reason is None:
            self.poses.append(estimate)
        if isinstance(event, RgbdFrame) and not localizer.note:
            self.photographer.look(event, estimate, localizer.last_matches)
            for stage, spent in localizer.stage_seconds.items():
                self.stage_seconds.setdefault(stage, []).append(spent)
        outcome = (estimate.status, estimate.reason, estimate.matches, estimate.inliers)
        index = event.index if isinstance(event, RgbdFrame | SkippedFrame) else len(self.frames)
        self.frames.append(FrameRecord(index, estimate.stamp_s, *outcome, seconds, localizer.note))
        return self.frames[-1]


@dataclass
class Passage:
    """One pass over a recording: every odometry's track, how long it took in all, and what broke it off."""

    tracks: tuple[Track, ...]
    elapsed_s: float = 0.0
    interruption: BaseException | None = None


def follow(
    recording: Recording, config: Config, on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None
) -> Passage:
    """Hand each event to every odometry named, in their order; without one that looks, no image is decoded."""
    passage = Passage(tuple(Track.begin(odometry, recording, config) for odometry in config.odometry))
    started = time.perf_counter()
    events = recording.events(images=any(track.needs_images for track in passage.tracks))
    try:
        for event in events:
            given = ((track.odometry, track.step(event)) for track in passage.tracks)
            answers: dict[str, FrameRecord] = {odometry: answer for odometry, answer in given if answer is not None}
            if answers and on_event is not None:
                on_event(answers)
    except (KeyboardInterrupt, WheelsightError) as interruption:
        passage.interruption = interruption
    finally:
        if isinstance(events, Generator):
            events.close()  # stops the reader's thread
    passage.elapsed_s = time.perf_counter() - started
    return passage
