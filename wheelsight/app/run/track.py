"""One pass over the events of a source with every requested odometry. LivedPoses keeps the poses as they were
answered.
"""

from __future__ import annotations

import ctypes
import gc
import tempfile
import time
import weakref
from array import array
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal, Protocol

import numpy as np

from wheelsight.app.run.kernels import DrawnDrive, InRealTime, rehearse
from wheelsight.app.run.maps import Stops
from wheelsight.app.run.run_record import AreaObservation, FrameRecord, MatchPicture
from wheelsight.app.run.run_source import frame_count_of, spread, unused_of, wheel_count_of
from wheelsight.config import OWN, Config, TrackName
from wheelsight.core.errors import ConfigError, PartError, WheelsightError
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import ByteArray, FloatArray, IntArray, se2, se3
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, YawRate
from wheelsight.core.robots import EventSource
from wheelsight.core.runtime import whole_step
from wheelsight.core.threads import FRAME, STAGE, in_spans, span
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer, Places, RectifiedEstimate
from wheelsight.estimation.odometry_choice import NO_PARTS, OwnParts
from wheelsight.io.recordings import Recording
from wheelsight.slam.maps import MapWriter
from wheelsight.slam.place_recognition import KnownMap

# Stamp, three rows of the pose, covariance, where odom lies: 416 bytes, where an estimate has some 2 kB.
_STAMP, _POSE, _COVARIANCE, _ODOM, _ROW = 0, slice(1, 13), slice(13, 49), slice(49, 52), 52
# 1.6 MB: wheels at 50 Hz fill it in 82 s.
_CHUNK = 4096


class LivedPoses:
    """Stores pose and covariance of each estimate bit for bit; wheels at 50 Hz give 180 000 an hour.

    Full chunks go to a temporary file. If the disk is full, they stay in memory.
    """

    def __init__(self) -> None:
        self._rows: FloatArray = np.empty((_CHUNK, _ROW))
        self._filled = self._stored = 0
        self._file: BinaryIO | None = None
        self._has_disk = True
        self._held: list[FloatArray] = []
        self._has_covariances = True

    def __len__(self) -> int:
        return self._stored + sum(map(len, self._held)) + self._filled

    def add(self, estimate: Estimate) -> None:
        """Store an estimate with a pose."""
        assert estimate.T_odom_body is not None
        if self._filled == _CHUNK:
            self._put_away(self._rows)
            self._filled = 0
        row, T, C = self._rows[self._filled], estimate.T_filter_body, estimate.filter_covariance
        assert T is not None
        row[_STAMP], row[_POSE] = estimate.stamp_s, np.ravel(T[:3])
        self._has_covariances &= C is not None
        row[_COVARIANCE] = 0.0 if C is None else np.ravel(C)
        row[_ODOM] = se2.to_parts(estimate.T_filter_odom[np.ix_([0, 1, 3], [0, 1, 3])])
        self._filled += 1

    def trajectory(self, body: str, frame: str) -> Trajectory:
        """The trajectory in the filter's frame, in order of time; at equal stamps the last answer counts."""
        stamps_s, at = self._in_order()
        T, C = _unmoved(len(stamps_s)), None
        if self._has_covariances and len(stamps_s):
            C = np.empty((len(stamps_s), 6, 6))
        for rows, kept in self._chunks_at(at):
            T[kept, :3] = rows[:, _POSE].reshape(-1, 3, 4)
            if C is not None:
                C[kept] = rows[:, _COVARIANCE].reshape(-1, 6, 6)
        for values in (T, C):
            if values is not None:
                values.setflags(write=False)  # a trajectory copies what might be written to
        return Trajectory(stamps_s, T, C, body=body, frame=frame)

    def odom(self, body: str) -> Trajectory | None:
        """The trajectory in odom, which is continuous; None if the filter's poses never jumped."""
        stamps_s, at = self._in_order()
        T, has_leapt = _unmoved(len(stamps_s)), False
        for rows, kept in self._chunks_at(at):
            has_leapt |= bool(rows[:, _ODOM].any())
            T[kept, :3] = rows[:, _POSE].reshape(-1, 3, 4)
            T[kept] = se3.invert(se3.from_plane(*rows[:, _ODOM].T)) @ T[kept]
        T.setflags(write=False)
        return Trajectory(stamps_s, T, body=body, frame="odom") if has_leapt else None

    def _in_order(self) -> tuple[FloatArray, IntArray]:
        """Ascending stamps (N,), and for each stored row its index among them; -1 if it has none."""
        answered_s = np.concatenate([rows[:, _STAMP].copy() for rows in self._chunks()])
        # With a delay of the wheels, readings come late. A frame may have the stamp of a reading.
        order = np.argsort(answered_s, kind="stable")
        stamps_s = answered_s[order]
        is_last = np.ones(len(order), bool)
        is_last[:-1] = np.diff(stamps_s) > 0
        at = np.full(len(order), -1)
        at[order[is_last]] = np.arange(np.count_nonzero(is_last))
        return stamps_s[is_last], at

    def _chunks_at(self, at: IntArray) -> Iterator[tuple[FloatArray, IntArray]]:
        """The rows of each chunk that have an index (N,), and these indices."""
        end = 0
        for rows in self._chunks():
            begin, end = end, end + len(rows)
            kept = at[begin:end]
            yield rows[kept >= 0], kept[kept >= 0]

    def _put_away(self, rows: FloatArray) -> None:
        try:
            if self._has_disk:
                if self._file is None:
                    self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open as long as the run goes
                    weakref.finalize(self, self._file.close)
                data = memoryview(rows.tobytes())
                self._file.seek(self._stored * rows[0].nbytes)  # over what a full disk took but in part
                while data:
                    data = data[self._file.write(data) :]
                self._stored += len(rows)
                return
        except OSError:
            self._has_disk = False
        self._held.append(rows.copy())

    def _chunks(self) -> Iterator[FloatArray]:
        """All rows in the order of their answers, chunk by chunk: an hour takes 82 MB."""
        for begin in range(0, self._stored, _CHUNK):
            rows = np.empty((min(_CHUNK, self._stored - begin), _ROW))
            assert self._file is not None
            self._file.seek(begin * rows[0].nbytes)
            into = rows.data.cast("B")
            while into:
                count = self._file.readinto(into)  # type: ignore[attr-defined]
                if not count:
                    raise OSError("a temporary file has lost poses of the run")
                into = into[count:]
            yield rows
        yield from self._held
        yield self._rows[: self._filled]


def _unmoved(count: int) -> FloatArray:
    T = np.zeros((count, 4, 4))
    T[:] = np.eye(4)
    return T


# What a track's record lists. Rectified and joined tracks list frames, though they have a pose at each reading too.
UNITS: dict[TrackName, Literal["frame", "reading"]] = {
    "features": "frame",
    "dense": "frame",
    "wheels": "reading",
    "own": "frame",
    "rectified": "frame",
    "joined": "frame",
}
_FLAGS = ("slip", "degenerate", "doubtful")
# Shares of an image's pixels. Dense odometry needs 5 % after lens and mount are taken out (`min_depth_share`): an image
# that has three times that, and leaves too little, is not what the calibration says. A covered sensor still has specks.
_ENOUGH_DEPTH, _ANY_DEPTH = 0.15, 0.005
DEPTH_MISPLACED = "the calibration puts the depth of the image out of its view"
DEPTH_MISSING = "no depth: the camera is covered, too near or too far"
DEPTH_SCARCE = "too little depth: most of the view is too near, too far, black, or glass"


class Photographer:
    """Takes pictures of matched frames at or after the `due` indices, and keeps at most two images."""

    def __init__(self, due: list[int]) -> None:
        self.pictures: list[MatchPicture] = []
        self._due = due
        self._images: dict[float, ByteArray] = {}

    def look(self, frame: RgbdFrame, estimate: Estimate, matches: Any) -> None:
        """Take a picture of `frame` if one is due and its reference image is kept."""
        if not self._due or estimate.T_odom_body is None:
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
class RunTrack:
    """One odometry over a recording, or the rectified wheels, with its answers so far.

    Attributes:
        odometry: its name.
        listed: number of frames or readings to answer; None if unknown.
        localizer: of the track.
        photographer: takes pictures.
        T_base_camera: (4, 4), or None if the tracked body is the camera.
        frames: a record of each answer to a frame or reading, by the track's unit.
        poses: answers with a pose.
        stage_seconds: times of each stage of each frame.
        looks: area probabilities of each frame, with places.
        stops: viewpoints for pictures of the map, if there is one.
        map_writer, map_path: writer and path of the map folder for the next drive, if any.
        extends: whether that is the known map; nothing is added to it before the drive is recognised in it.
        last: the last answer, or None.
        found: the first answer with a pose in a known map, or None.
    """

    odometry: TrackName
    listed: int | None
    localizer: Localizer
    photographer: Photographer
    T_base_camera: FloatArray | None = None
    frames: list[FrameRecord] = field(default_factory=list)
    poses: LivedPoses = field(default_factory=LivedPoses)
    stage_seconds: dict[str, array[float]] = field(default_factory=dict)
    looks: list[AreaObservation] = field(default_factory=list)
    stops: Stops = field(default_factory=lambda: Stops([]))
    map_writer: MapWriter | None = None
    map_path: Path | None = None
    extends: bool = False
    last: Estimate | None = None
    found: Estimate | None = None

    @classmethod
    def begin(
        cls,
        odometry: TrackName,
        source: EventSource,
        config: Config,
        places: Places | None,
        known: KnownMap | None = None,
        parts: OwnParts = NO_PARTS,
    ) -> RunTrack:
        """A new track. Raises CalibrationError, ConfigError."""
        listed = wheel_count_of(source) if UNITS[odometry] == "reading" else frame_count_of(source)
        waits = isinstance(source, Recording) and not isinstance(source, InRealTime)
        localizer = Localizer(
            source.calibration,
            config.alone(odometry),
            places,
            known=known,
            waits=waits,
            visual_odometry=parts.visual_odometry if UNITS[odometry] == "frame" and odometry != "rectified" else None,
            loop_detector=parts.loop_detector,
        )
        due = spread(config.report.pictures, frame_count_of(source))
        stops = Stops(list(due) if localizer.map is not None else [])
        return cls(odometry, listed, localizer, Photographer(due), source.calibration.T_base_camera, stops=stops)

    @property
    def needs_images(self) -> bool:
        """Whether the track uses images."""
        return RgbdFrame in self.localizer.answers

    def step(self, event: Event, overtaken: int = 0) -> FrameRecord | None:
        """Process one event; None if the track does not use it. `overtaken` frames were dropped just before."""
        localizer = self.localizer
        if not isinstance(event, localizer.hears):
            return None  # another track may use it; `unused_of` says what none does
        started = time.perf_counter()
        category = FRAME if isinstance(event, RgbdFrame) else STAGE
        with span(f"{self.odometry}: {type(event).__name__}", category, stamp_s=event.stamp_s):
            estimate = localizer.process(event)
        seconds = time.perf_counter() - started
        if estimate is None:
            return None
        self.last = estimate
        is_posed = estimate.T_odom_body is not None
        if self.found is None and localizer.recognised and is_posed and estimate.status is not Status.INITIALIZING:
            self.found = estimate
        is_joined = self.odometry == "joined"  # the joined filter has a pose even if the event gave no motion
        if is_posed and (estimate.reason is None or is_joined):
            self.poses.add(estimate)
        if isinstance(event, RgbdFrame) and not localizer.note:
            self.photographer.look(event, estimate, localizer.last_matches)
            self.stops.look(event, estimate, localizer.T_odom_map, self.T_base_camera)
            self._add_stages(localizer.stage_seconds)
        outcome = (estimate.status, estimate.reason, estimate.matches, estimate.inliers)
        index = event.index if isinstance(event, RgbdFrame | SkippedFrame) else len(self.frames)
        flags = tuple(flag for flag in _FLAGS if getattr(estimate, flag, False))
        stamp_s = event.stamp_s if isinstance(event, RgbdFrame | SkippedFrame) else estimate.stamp_s
        posed_s = estimate.stamp_s if is_posed else None
        surfels = localizer.map
        size: tuple[int | None, int] = (None, 0) if surfels is None else (len(surfels), surfels.dropped)
        is_frame = isinstance(event, RgbdFrame | SkippedFrame)
        is_unread = isinstance(event, SkippedFrame) and not event.is_blind
        note, dropped = localizer.note or _why_no_depth(event, estimate), (overtaken, is_unread)
        answer = FrameRecord(index, stamp_s, *outcome, seconds, note, *size, flags, posed_s, *dropped)
        if is_frame:
            self._keep(estimate)
        if is_frame or UNITS[self.odometry] == "reading":
            self.frames.append(answer)
        if is_frame and self.odometry == "rectified":
            self.looks.append(_look(localizer, estimate))
        return answer

    def _keep(self, estimate: Estimate) -> None:
        """Write new keyframes for the next drive. Edges of an extended map follow at the end."""
        if self.map_writer is None:
            return
        if not self.extends:
            self.map_writer.update(estimate)
        elif self.localizer.loops is not None and self.localizer.loops.is_joined:
            self.map_writer.update(None)

    def _add_stages(self, seconds: Mapping[str, float]) -> None:
        if seconds.keys() > self.stage_seconds.keys():
            # The first frame skips stages: their order is that of a frame which has them all.
            self.stage_seconds = {stage: self.stage_seconds.get(stage, array("d")) for stage in seconds}
        for stage, spent in seconds.items():
            self.stage_seconds.setdefault(stage, array("d")).append(spent)


def _why_no_depth(event: Event, estimate: Estimate) -> str:
    """The cause of "too little depth": the image has none, or its calibration moves it out of view."""
    if not isinstance(event, RgbdFrame) or estimate.reason is not Reason.TOO_LITTLE_DEPTH:
        return ""
    share = np.count_nonzero(event.depth_m > 0) / event.depth_m.size
    if share >= _ENOUGH_DEPTH:
        return DEPTH_MISPLACED
    return DEPTH_MISSING if share < _ANY_DEPTH else DEPTH_SCARCE


def _look(localizer: Localizer, estimate: Estimate) -> AreaObservation:
    match, note = localizer.last_place, localizer.note
    belief, trust = None, float("nan")
    if isinstance(estimate, RectifiedEstimate):
        belief, trust = estimate.area_probabilities, estimate.trust
    if match is None or note:  # what a model says of a frame without depth is nothing
        return AreaObservation(estimate.stamp_s, belief=belief, trust=trust, note=note)
    named = -1 if match.area_index is None else match.area_index
    return AreaObservation(estimate.stamp_s, match.probabilities, named, belief, trust)


class Watcher(Protocol):
    """A listener to a run, such as a viewer. It changes nothing."""

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> None:
        """Called after an answered event."""

    def finish(self, tracks: Sequence[RunTrack]) -> None:
        """Called at the end of the run, after loop closing."""


@dataclass
class Passage:
    """One pass over a recording.

    Attributes:
        tracks: of every odometry.
        elapsed_s: duration of the pass.
        interruption: the exception that ended it, or None.
        is_torn: whether the interruption came within a step, so that unfinished data is invalid.
        unused: one sentence about each unused sensor of the recording.
    """

    tracks: tuple[RunTrack, ...]
    elapsed_s: float = 0.0
    interruption: BaseException | None = None
    is_torn: bool = False
    unused: tuple[str, ...] = ()


def begin_all(
    source: EventSource,
    config: Config,
    places: Places | None,
    known: KnownMap | None = None,
    parts: OwnParts = NO_PARTS,
) -> tuple[RunTrack, ...]:
    """All tracks of a run; `known` and a loop detector go to the track that has the map.

    Raises CalibrationError, ConfigError.
    """
    # In real time a joined run skips the camera-only tracks, which would cost frames.
    if isinstance(source, InRealTime | DrawnDrive) and config.fusion.filter != "none":
        names = tuple(track for track in config.tracks if track not in ("features", "dense", "own"))
    else:
        names = config.tracks
    if parts.loop_detector is not None and sum(has_map(name, names) for name in names) != 1:
        raise ConfigError("loop_detector is for one odometry by a camera", fix="--odometry dense, or wheels,dense")
    return tuple(
        RunTrack.begin(name, source, config.without_known_map(), places, None, replace(parts, loop_detector=None))
        if not has_map(name, names)
        else RunTrack.begin(name, source, config if known else config.without_known_map(), places, known, parts)
        for name in names
    )


def has_map(name: str, names: Collection[str]) -> bool:
    """Whether a track keeps keyframes: a camera's track, or the joined track if there is one."""
    return name == "joined" or (UNITS[name] == "frame" and "joined" not in names)  # type: ignore[index]


def follow(
    tracks: tuple[RunTrack, ...],
    source: EventSource,
    config: Config,
    on_event: Callable[[Mapping[str, FrameRecord]], None] | None = None,
    places: Places | None = None,
    duration_s: float | None = None,
    watcher: Watcher | None = None,
) -> Passage:
    """Process each event with every track, in their order. Without a track that needs images, none is decoded.

    Ends with the source, at the first event `duration_s` after the first, or by Ctrl-C. Then the localizers are closed.
    """
    passage, yaw_rates, dropped = Passage(tracks), 0, 0
    events = source.events(images=any(track.needs_images for track in tracks))
    started = time.perf_counter()
    try:
        if isinstance(source, InRealTime):
            _rehearse_all(source, config, places)
            give_back()
            started = time.perf_counter()
        for event in _until(in_spans("next event", iter(events)), duration_s):
            yaw_rates += isinstance(event, YawRate)
            overtaken = 0  # frames dropped in real time since the last frame
            if isinstance(event, RgbdFrame | SkippedFrame) and isinstance(source, InRealTime):
                overtaken = max(source.frames_so_far[1] - dropped, 0)
            dropped += overtaken
            with whole_step(), span("event"):
                passage.is_torn = True
                given = [(track.odometry, track.step(event, overtaken)) for track in passage.tracks]
                passage.is_torn = False
            answers: dict[str, FrameRecord] = {odometry: answer for odometry, answer in given if answer is not None}
            with span("show"):
                if answers and watcher is not None:
                    watcher.step(event, answers, tracks)
                if answers and on_event is not None:
                    on_event(answers)
    except (KeyboardInterrupt, WheelsightError) as interruption:
        passage.interruption = interruption
        passage.is_torn &= isinstance(interruption, KeyboardInterrupt)  # errors are raised before anything changes
    finally:
        if isinstance(events, Generator):
            events.close()  # stops the reader's thread
        for track in tracks:
            try:
                track.localizer.close()
            except PartError as error:  # what was tracked is written all the same
                passage.interruption = passage.interruption or error
    passage.elapsed_s = time.perf_counter() - started
    passage.unused = unused_of(source, config, yaw_rates)
    return passage


def _rehearse_all(source: InRealTime, config: Config, places: Places | None) -> None:
    """Rehearse with separate localizers: those of the run must not have processed any event."""
    # A part of a user's own has no kernels here, and must not see these frames.
    names = tuple("features" if name == OWN else name for name in config.odometry)
    config = config.model_copy(update={"odometry": names})
    for rehearsed in source.rehearsals():
        rehearse(rehearsed, [track.localizer for track in begin_all(rehearsed, config, places)])


def _until(events: Iterable[Event], duration_s: float | None) -> Iterator[Event]:
    """Events up to `duration_s` after the first; all events if it is None."""
    begin_s: float | None = None
    for event in events:
        begin_s = event.stamp_s if begin_s is None else begin_s
        if duration_s is not None and event.stamp_s - begin_s >= duration_s:
            return
        yield event


# give_back: memory that was freed goes back to the system, where the C library would keep it.


def give_back() -> None:
    """Return free memory of glibc to the system; no effect elsewhere. It takes some 20 ms, so never call it while
    driving.

    Loading kernels allocates many small pieces between others. Without this call glibc returns only the end of its
    heap.
    """
    gc.collect()
    with suppress(OSError, AttributeError, TypeError):  # no glibc
        ctypes.CDLL(None).malloc_trim(0)
