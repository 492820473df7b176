"""Localizer: returns an estimate of the robot's pose for each event.

`SmallerImages` halves images on slow computers. `RestingKeyframes` moves keyframes of drives without a map to disk.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
import weakref
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import SessionClock, Untimed, check_event, check_images, need_calibration, need_kind
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, PinholeCamera
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, YawRate
from wheelsight.core.settings import LocalizerSettings
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import Closing, OneCaller, ends, one_at_a_time
from wheelsight.estimation.area_localizer import ByPlaces, Places, load_places
from wheelsight.estimation.camera_localizer import ByFrames, CameraOdometry
from wheelsight.estimation.fusion_localizer import ByFusion
from wheelsight.estimation.loop_updates import LoopClosureClient
from wheelsight.estimation.odometry_choice import FRAMES, RATES, READINGS, OwnParts, choose_odometry, why_unused
from wheelsight.estimation.wheel_localizer import ByWheels
from wheelsight.mapping import SurfelMap
from wheelsight.places import PlaceMatch
from wheelsight.slam.place_recognition import KnownMap, LoopDetector
from wheelsight.slam.settings import FROM_KEYFRAMES
from wheelsight.vision.dense import DEPTH_JUMP, halved_depth
from wheelsight.vision.features import MatchedPixels
from wheelsight.vision.visual_odometry import VisualOdometry
from wheelsight.wheels import AnyWheelOdometry

if TYPE_CHECKING:
    from wheelsight_papers.ligocki import ByLigocki

_LOG = logging.getLogger(__name__)
_NUMBER = re.compile(r"\d[\d.,]*")
_KINDS = {RgbdFrame: FRAMES, SkippedFrame: FRAMES, **dict.fromkeys(WHEEL_READINGS, READINGS), YawRate: RATES}
_CONFIG_FIX = 'load_config(PATH), or load_config(overrides={"odometry": "dense"})'


class Localizer(Closing, OneCaller):
    """Returns the pose of the body at each frame or wheel reading, or the reason why there is none.

    `config.odometry` selects the sensors. By default the localizer fuses all sensors that the calibration describes
    (`choose_odometry`): wheels and camera if both and `T_base_camera` are known, else the camera, else the wheels.

    - `features` or `dense`: answers frames. The body is the base if `T_base_camera` is known, else the camera. The map
      frame starts at the body's pose at the first tracked frame. With `map: surfels`, dense odometry builds a surfel
      map and tracks against it.
    - `wheels`: answers wheel readings. The body is the base. Its frame `odom` starts at the first reading.
    - `[wheels, dense]` or `[wheels, features]`: `fusion` selects the filter. The default filter answers readings and
      frames with a `FusedEstimate`, whose status and flags state how reliable it is. Ligocki's filter answers frames.
      The body is the base. The map starts at the first event (Ligocki: at the first tracked frame).
    - `places` with wheels: answers both. Wheels predict the pose and each frame corrects it by the area it shows. The
      map is that of the areas. With wheels and camera, the area is one more measurement of the default filter.

    Only one thread calls it at a time, in the process that made it. Several threads may take turns.

    Args:
        calibration: of the sensors.
        config: all settings; None for the defaults. `config.alone(track)` selects one of several tracks.
        places: model, areas and start, if `config.places` does not have them all.
        known: an existing map, in which the robot localizes; needs `loops: {source: keyframes}`. Until the place is
            recognised, estimates are `INITIALIZING`: they have a pose in odom and none in the map.
        waits: whether to wait for loops once they are due, so that a recording gives the same poses in each run. Use
            False on a robot.
        visual_odometry: replaces the built-in camera odometry; wheels are fused in the same way. Its failures count
            as those of the built-in ones: `FAILING`, then `LOST`, and `COASTING` with wheels.
        loop_detector: names keyframes that may show the same place; loops are closed while driving.

    Attributes:
        body: "base" or "camera".
        frame: "map" or "odom", the frame of the poses.
        answers: the types of events that get an estimate.
        hears: the types of events that it uses. Any other type adds one warning to `warnings` and to the log.
        note: detail about the last event beyond its reason; often empty.

    Raises:
        ConfigError: the configuration names odometries that cannot be fused, or places without areas or start; or a
            custom part is not used.
        CalibrationError: the calibration lacks the cameras or wheels that the odometry needs.
        AreaError, PlaceError: areas or model cannot be read, or do not belong together.
    """

    def __init__(
        self,
        calibration: Calibration,
        config: Config | None = None,
        places: Places | None = None,
        *,
        known: KnownMap | None = None,
        waits: bool = False,
        visual_odometry: VisualOdometry | None = None,
        loop_detector: LoopDetector | None = None,
    ) -> None:
        calibration = need_calibration(calibration)
        settings = Config() if config is None else need_kind("config", config, Config, _CONFIG_FIX)
        choice, parts = choose_odometry(calibration, settings), OwnParts(visual_odometry, loop_detector)
        settings = parts.named_in(settings, choice)
        self._choice, self._config, self._unused = choice, settings, dict[str, str]()
        if known is not None and settings.loops.source != FROM_KEYFRAMES:
            raise ConfigError(
                "a known map needs loop closing", fix='load_config(overrides={"loops.source": "keyframes"})'
            )
        if len(settings.odometry) > 1 and settings.fusion.filter == "none":
            several = " and ".join(settings.odometry)
            raise ConfigError(f"a localizer uses one odometry, not {several}", fix="pass config.alone(name)")
        # A model of places was trained on images of one size, and reports any other size itself.
        self._has_places = places is not None or settings.places.model is not None
        # A custom visual odometry expects images as the calibration describes them.
        is_full_size = self._has_places or visual_odometry is not None
        most_width_px = None if is_full_size else settings.localizer.most_width_px
        self._images = SmallerImages(calibration, most_width_px, DEPTH_JUMP)
        self._calibration = calibration
        self._estimator = _estimator(self._images.calibration, settings, places, known, parts, waits=waits)
        self.body, self.frame = self._estimator.body, self._estimator.frame
        self.answers, self.hears = self._estimator.answers, self._estimator.hears
        self._loops = self._estimator.loops
        self.note, self._resting = "", resting_keyframes(self.keyframes, settings.localizer)
        self._clock = SessionClock(settings.clocks)
        self._stamps = StampCheck()
        self._log, self._watch = _EstimateLog("+".join(settings.odometry)), self._estimator.watch

    @one_at_a_time
    def process(self, event: Event) -> Estimate | None:
        """Return the estimate at an event, or None if events of its type are not answered.

        An event that is not used adds a warning, once for each type. Frames without a measurement:

        - An unreadable frame, or one that is not newer than the previous one, counts as a failed frame: no pose, reason
          `FRAME_UNUSABLE`, and `note` gives the detail. With wheels, the pose is still known.
        - An image that repeats under another stamp, as from a camera that is logged at twice its rate, is ignored: its
          reason is `REPEATED`. If a camera without wheels repeats one image for over a second, frames count as failed.

        A `SessionClock` checks each stamp. It absorbs jumps of one clock or of all clocks. A stamp far from all others
        is refused, with a reason and a note.

        Raises:
            ArgumentError: no event, stamps that are not seconds, images of another shape or type than the
                calibration's, or depth that is not in metres. A concurrent call, a call in a forked process, or a call
                after `close`.
            PlaceError: a frame of another size than the model of places was trained on.
            PartError: a custom part raised an exception or returned an invalid result.
        """
        check_event(event)
        if isinstance(event, RgbdFrame) and RgbdFrame in self.hears:
            self._watch.begin_frame()
            check_images(event, self._calibration, of_any_size=self._has_places)
        self.note = ""
        if not isinstance(event, self.hears):
            what = _KINDS[type(event)]
            if what not in self._unused:
                self._unused[what] = why_unused(what, self._config, self._choice)
                self._log.warn(self.warnings)
            return None
        if type(event) not in self._stamps.settled:
            self._stamps.check(event)
        time_s = self._clock.time_of(event)
        if isinstance(time_s, Untimed):
            shifted = replace(event, stamp_s=event.stamp_s - self._clock.shift_s)
            estimate, self.note = self._estimator.refuse(shifted, time_s)
        else:
            timed = event if time_s == event.stamp_s else replace(event, stamp_s=time_s)
            timed = self._images.frame(timed) if isinstance(timed, RgbdFrame) else timed
            estimate, self.note = self._estimator.process(timed)
        if self._resting is not None and isinstance(event, RgbdFrame):
            self._resting.look()
        recognised = None if self._loops is None else self._loops.recognised
        self._log.add(estimate, self.note, recognised, self.warnings)
        shift_s = self._clock.shift_s
        if isinstance(event, RgbdFrame):
            self._watch.lap("decide", ends_frame=True)
        return estimate if estimate is None or not shift_s else replace(estimate, stamp_s=estimate.stamp_s + shift_s)

    @property
    def odometry(self) -> CameraOdometry | AnyWheelOdometry:
        """Odometry of the camera, or of the wheels if there is no camera."""
        return self._estimator.odometry

    @property
    def last_matches(self) -> MatchedPixels | None:
        """Pixels by which the last frame was aligned; None if it was not aligned by pixels."""
        return self._images.in_full(self._estimator.last_matches)

    @property
    def last_place(self) -> PlaceMatch | None:
        """Result of the model of places for the last frame; None if it was not asked."""
        return self._estimator.last_place

    @property
    def map(self) -> SurfelMap | None:
        """Surfel map of this run, which lies at `T_odom_map`; None if the configuration asks for no map."""
        mapper = self._estimator.mapper
        return None if mapper is None else mapper.map

    @property
    def keyframes(self) -> KeyframeStore | None:
        """Keyframes of the camera and their poses; None for wheels alone. Moving one moves what refers to it."""
        return self._estimator.keyframes

    @property
    def loops(self) -> LoopClosureClient | None:
        """Loop closing while driving, with `loops: {source: keyframes}` and a camera; else None."""
        return self._loops

    @property
    def recognised(self) -> int | None:
        """Number of recognitions of the known map so far; None without one. See `LiveLoops`."""
        return None if self._loops is None else self._loops.recognised

    @property
    def T_odom_map(self) -> FloatArray:
        """(4, 4) pose of the map: the identity for a single odometry without loop closing.

        The filter corrects T_odom_body by measurements that no camera makes, such as the level floor. The map keeps its
        shape. In the map the body is at `inv(T_odom_map) @ T_odom_body`.
        """
        return self._estimator.T_odom_map

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each sensor that is unused or wrong, and for each jump of a clock."""
        return (*self._unused.values(), *self._estimator.warnings, *self._clock.warnings)

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Wall time of each stage of the last frame. Nested stages are not counted twice."""
        return self._watch.seconds

    @property
    def stage_processor_seconds(self) -> dict[str, float]:
        """Processor time of the thread in each stage of the last frame."""
        return self._watch.processor_seconds

    @ends
    def close(self) -> None:
        """End its threads at the end of a run. May be called twice; the results remain readable.

        Raises any error of these threads, and ArgumentError while another thread processes an event.
        """
        if self.keyframes is not None:
            self.keyframes.close()
        if self._loops is not None:
            self._loops.close()


def _estimator(
    calibration: Calibration,
    settings: Config,
    places: Places | None,
    known: KnownMap | None,
    parts: OwnParts,
    *,
    waits: bool,
) -> ByFrames | ByWheels | ByPlaces | ByFusion | ByLigocki:
    """Return the estimator that the configuration selects."""
    if settings.fusion.filter == "ligocki":
        from wheelsight_papers.ligocki import ByLigocki

        return ByLigocki(calibration, settings, parts)
    has_model = settings.places.model is not None
    if settings.fusion.filter != "none":
        areas = (places or load_places(settings.places)) if has_model else None
        return ByFusion(calibration, settings, areas, known, waits=waits, parts=parts)
    if has_model:
        return ByPlaces(calibration, settings, places or load_places(settings.places))
    if settings.odometry == ("wheels",):
        return ByWheels(calibration, settings.wheels, in_odom=True)
    return ByFrames(calibration, settings, known, waits=waits, parts=parts)


class _EstimateLog:
    """Logs warnings, changes of status, recognitions of the known map, and frames without a measurement.

    Args:
        name: of the odometry, to distinguish several localizers of one run.
    """

    def __init__(self, name: str) -> None:
        self._name, self._status, self._recognised, self._warned = name, Status.INITIALIZING, 0, set[str]()

    def add(self, estimate: Estimate | None, note: str, recognised: int | None, warnings: tuple[str, ...]) -> None:
        """Log the answer to one event."""
        if warnings:
            self.warn(warnings)
        if estimate is None:
            return
        why = ": ".join(filter(None, (estimate.reason, note)))
        if estimate.status is not self._status:
            of = f"{estimate.status}, was {self._status}" + (f": {why}" if why else "")
            _LOG.info("%.3f s: %s is %s", estimate.stamp_s, self._name, of)
            self._status = estimate.status
        elif why:
            _LOG.debug("%.3f s: %s: %s", estimate.stamp_s, self._name, why)
        if recognised is not None and recognised > self._recognised:
            if not self._recognised:
                _LOG.info("%.3f s: %s is recognised in the known map", estimate.stamp_s, self._name)
            self._recognised = recognised

    def warn(self, warnings: tuple[str, ...]) -> None:
        """Log new warnings. A warning that differs only in its numbers is not new."""
        for sentence in warnings:
            kind = _NUMBER.sub("", sentence)
            if kind not in self._warned:
                self._warned.add(kind)
                _LOG.warning(sentence)


class SmallerImages:
    """Halves the images of both cameras until they are at most `most_width_px` wide, for slow computers.

    Args:
        calibration: of the original frames.
        most_width_px: wider images are halved; None keeps all sizes.
        depth_jump: relative depth difference that separates two surfaces; depth is not averaged across it.

    Attributes:
        calibration: of the smaller frames.
    """

    def __init__(self, calibration: Calibration, most_width_px: int | None, depth_jump: float) -> None:
        self._color_halvings = _halvings(calibration.color, most_width_px)
        self._depth_halvings = _halvings(calibration.depth, most_width_px)
        self._jump = depth_jump
        self.calibration = calibration
        if calibration.color is not None and calibration.depth is not None:
            self.calibration = replace(
                calibration,
                color=calibration.color.halved(self._color_halvings),
                depth=calibration.depth.halved(self._depth_halvings),
                color_sigma_px=calibration.color_sigma_px / 2**self._color_halvings,
            )

    def frame(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with smaller images."""
        if not (self._color_halvings or self._depth_halvings):
            return frame
        color, depth_m = frame.color, frame.depth_m
        if self._color_halvings:
            height, width = (size >> self._color_halvings for size in color.shape[:2])
            whole = color[: height << self._color_halvings, : width << self._color_halvings]
            color = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        for halving in range(self._depth_halvings):
            # At half the resolution the same slope has twice the step from pixel to pixel.
            depth_m = halved_depth(depth_m, self._jump * (1 << halving))
        return replace(frame, color=color, depth_m=depth_m)

    def in_full(self, matches: MatchedPixels | None) -> MatchedPixels | None:
        """Return matched pixels of a smaller colour image as pixels of the original one."""
        if matches is None or not self._color_halvings:
            return matches
        px, reference_px = (
            np.asarray((px + 0.5) * 2**self._color_halvings - 0.5) for px in (matches.px, matches.reference_px)
        )
        return replace(matches, px=px, reference_px=reference_px)


def _halvings(camera: PinholeCamera | None, most_width_px: int | None) -> int:
    times = 0
    while camera is not None and most_width_px is not None and camera.width >> times > most_width_px:
        times += 1
    return times


def resting_keyframes(store: KeyframeStore | None, settings: LocalizerSettings) -> RestingKeyframes | None:
    """Return what limits the memory of a store; None without a store, or without a limit in the settings."""
    if store is None or settings.memory_keyframes is None:
        return None
    return RestingKeyframes(store, settings.memory_keyframes, settings.resting_folder)


_FILE_LOST = "the disk is full or gone: free some, or drive on without this keyframe"


class RestingKeyframes:
    """Limits the memory of a store that no map writes: older keyframes move to a temporary file, bit for bit.

    A keyframe moves once `memory_keyframes` newer ones exist. If the file cannot be written, all later ones stay in
    memory.

    Args:
        store: of the odometry.
        memory_keyframes: see `KeyframeStore.limit_memory`.
        folder: where the file is made on first use; None for the system's temporary folder.
    """

    def __init__(self, store: KeyframeStore, memory_keyframes: int, folder: StrPath | None = None) -> None:
        self._store, self._most, self._folder = store, memory_keyframes, folder
        self._next = len(store)  # the map has those before
        self._file: BinaryIO | None = None
        self._end, self._has_disk = 0, True

    def look(self) -> None:
        """Move keyframes to the file after a frame has added to the store."""
        while self._has_disk and not self._store.is_written and self._next < len(self._store) - self._most:
            number, self._next = KeyframeId(self._next), self._next + 1
            try:
                keyframe = self._store[number]
            except Exception:  # it could not be made: the store raises that again at each access
                continue
            try:
                self._put(number, keyframe)
            except OSError:
                self._has_disk = False

    def _put(self, number: KeyframeId, keyframe: Keyframe) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - as long as the store may read
            weakref.finalize(self._store, self._file.close)
            self._store.limit_memory(self._most)
        images = [np.frombuffer(png, np.uint8) for png in (keyframe.depth_png, keyframe.grey_png)]
        features, code = keyframe.features, keyframe.code
        arrays: list[NDArray[np.generic]] = [np.array([keyframe.stamp_s]), keyframe.intrinsics, *images]
        arrays += [np.zeros(0) if code is None else code]
        arrays += [] if features is None else [features.px, features.points, features.descriptors]
        self._file.seek(self._end)
        for array in arrays:
            self._file.write(array.tobytes())
        self._file.flush()
        like = [(array.dtype, array.shape) for array in arrays]
        self._store.keep_on_disk(number, partial(_read, self._file, self._end, like))
        self._end = self._file.tell()


def _read(file: BinaryIO, begin: int, like: list[tuple[np.dtype[np.generic], tuple[int, ...]]]) -> Keyframe:
    """Return a keyframe from its arrays in the file, in the order that `RestingKeyframes` writes. Raises MapError."""
    sizes = [dtype.itemsize * int(np.prod(shape)) for dtype, shape in like]
    try:
        data = os.pread(file.fileno(), sum(sizes), begin)  # safe in any thread while another one writes
    except OSError as error:
        raise MapError(f"a keyframe cannot be read again: {error}", fix=_FILE_LOST) from error
    if len(data) != sum(sizes):
        raise MapError("a keyframe in the temporary file is cut off", fix=_FILE_LOST)
    ends = np.cumsum(sizes)
    parts = [
        np.frombuffer(data[end - size : end], dtype).reshape(shape)
        for end, size, (dtype, shape) in zip(ends, sizes, like, strict=True)
    ]
    (stamp_s,), intrinsics, depth, grey, code, *of_features = parts
    features = KeyframeFeatures(*of_features) if of_features else None
    return Keyframe(float(stamp_s), intrinsics, depth.tobytes(), grey.tobytes(), features, code if len(code) else None)
