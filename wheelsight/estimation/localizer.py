"""Localizer: returns an estimate of the robot's pose for each event. It also halves images on slow computers and
keeps keyframes of drives without a map on disk.
"""

from __future__ import annotations

import logging
import os
import re
import tempfile
import weakref
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import check_event, check_images, need_calibration, need_kind
from wheelsight.core.clocks import SessionClock, Untimed
from wheelsight.core.errors import ConfigError, MapError
from wheelsight.core.estimates import Estimate, Status, WheelEstimate
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId, KeyframeStore
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame, YawRate
from wheelsight.core.settings import LocalizerSettings
from wheelsight.core.stamps import StampCheck
from wheelsight.core.threads import OneCaller, Rows, ends, one_at_a_time
from wheelsight.estimation.area_localizer import ByPlaces, Places, load_places
from wheelsight.estimation.camera_localizer import ByFrames, CameraOdometry
from wheelsight.estimation.fusion_localizer import ByFusion
from wheelsight.estimation.ligocki import ByLigocki
from wheelsight.estimation.loop_updates import LoopsBeside
from wheelsight.estimation.odometry_choice import FRAMES, RATES, READINGS, OwnParts, choose_odometry, why_unused
from wheelsight.estimation.wheel_localizer import ByWheels
from wheelsight.mapping import SurfelMap
from wheelsight.places import PlaceMatch
from wheelsight.slam.place_recognition import KnownMap, LoopDetector
from wheelsight.slam.settings import FROM_KEYFRAMES
from wheelsight.vision.dense import halved_depth
from wheelsight.vision.features import MatchedPixels
from wheelsight.vision.visual_odometry import VisualOdometry
from wheelsight.wheels import AnyWheelOdometry

# Localizer: where the robot is, event by event. The whole step on one screen.


_LOG = logging.getLogger(__name__)
_NUMBER = re.compile(r"\d[\d.,]*")
_KINDS = {RgbdFrame: FRAMES, SkippedFrame: FRAMES, **dict.fromkeys(WHEEL_READINGS, READINGS), YawRate: RATES}
_CONFIG_FIX = 'load_config(PATH), or load_config(overrides={"odometry": "dense"})'


class Localizer(OneCaller):
    """Answers each frame or wheel reading with the pose of the body at its stamp, or with the reason why there is none.

    Where the configuration names no odometry, all sensors that the calibration has are joined: wheels and camera where
    it has both and `T_base_camera`, else the camera, else the wheels (`choose_odometry`). Who wants less names it.

    With `odometry: features` or `dense` frames are answered; the body is the robot's base where the calibration knows
    `T_base_camera`, else the camera; the map begins where the body was at the first tracked frame. With `odometry:
    wheels` the wheel readings are answered; the body is the base, its frame `odom`, which begins at the first reading.
    With `map: surfels` dense odometry builds a map on the way and tracks against it.
    With `odometry: [wheels, dense]` or `[wheels, features]` both are joined, by `fusion`: the default filter answers
    readings and frames with a `FusedEstimate`, whose status and flags say how far to trust it; Ligocki's answers
    frames. The body is the base, the map begins where it was at the first event (Ligocki: at the first tracked frame).
    With `places` beside wheels, both are answered: wheels lead from frame to frame, each frame corrects them by the
    area it shows; the map is that of the areas. Beside joined wheels and camera the area is one more measurement of
    the default filter.

    One thread calls it at a time, in the process that made it; several may take turns.

    Args:
        calibration: of the sensors.
        config: all settings; of None, the defaults. `config.alone(track)` picks one of several tracks.
        places: model, areas and start, where they are not all in `config.places`.
        known: a map of before, in which it finds itself; with `loops: {source: keyframes}`. Until the place is
            recognised its answers are `INITIALIZING`: they have a pose in odom, and none in the map.
        waits: whether loops are waited for once they are due, so that a recording gives the same poses each time. A
            robot that drives does not wait.
        visual_odometry: of your own, follows the camera in place of the built-in ones; wheels are joined as beside
            these. Its failures count as theirs: `FAILING`, then `LOST`, and `COASTING` by wheels.
        loop_detector: of your own, names keyframes that may show the same place; loops are closed while driving.

    Attributes:
        body: "base" or "camera".
        frame: "map" or "odom", in which poses are.
        answers: the types of the events that are answered.
        hears: the types of the events that it uses; any other kind is warned of once, in `warnings` and by `logging`.
        note: what there is to say about the last event beyond its reason; often empty.

    Raises:
        ConfigError: the configuration names odometries that it does not join, or places without areas or start; or a
            part of your own has no use.
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
                "a known map is found by loops", fix='load_config(overrides={"loops.source": "keyframes"})'
            )
        if len(settings.odometry) > 1 and settings.fusion.filter == "none":
            several = " and ".join(settings.odometry)
            raise ConfigError(f"a localizer goes by one odometry, not by {several}", fix="give it config.alone(name)")
        # A model of places, which was trained on images of one size, says itself what is wrong with others.
        self._has_places = places is not None or settings.places.model is not None
        # A visual odometry of a user's own knows the images as the calibration has them.
        is_in_full = self._has_places or visual_odometry is not None
        most_width_px = None if is_in_full else settings.localizer.most_width_px
        self._images = SmallerImages(calibration, most_width_px, settings.dense.depth_jump)
        self._calibration, calibration = calibration, self._images.calibration
        self._way: ByFrames | ByWheels | ByPlaces | ByFusion | ByLigocki
        if settings.fusion.filter != "none":
            self._way = _joined(calibration, settings, places, known, parts, waits=waits)
        elif settings.places.model is not None:
            self._way = ByPlaces(calibration, settings, places or load_places(settings.places))
        elif settings.odometry == ("wheels",):
            self._way = ByWheels(calibration, settings.wheels)
        else:
            self._way = ByFrames(calibration, settings, known, waits=waits, parts=parts)
        self.body, self.frame = self._way.body, self._way.frame
        self.answers, self.hears = self._way.answers, self._way.hears
        self.note, self._resting = "", resting_keyframes(self.keyframes, settings.localizer)
        self._clock = SessionClock(settings.clocks)
        self._stamps = StampCheck()
        self._log = _Log("+".join(settings.odometry))

    @property
    def odometry(self) -> CameraOdometry | AnyWheelOdometry:
        """What estimates the motion."""
        return self._way.odometry

    @property
    def last_matches(self) -> MatchedPixels | None:
        """What the last frame was aligned by, if it was a frame that could be."""
        return self._images.in_full(self._way.last_matches)

    @property
    def last_place(self) -> PlaceMatch | None:
        """What places said of the last frame, where they were asked."""
        return self._way.last_place if isinstance(self._way, ByPlaces | ByFusion) else None

    @property
    def map(self) -> SurfelMap | None:
        """What was built on the way, where `T_odom_map` has it; None where the configuration asks for no map."""
        mapper = None if isinstance(self._way, ByWheels | ByPlaces) else self._way.mapper
        return None if mapper is None else mapper.map

    @property
    def keyframes(self) -> KeyframeStore | None:
        """What the camera remembers, and where; None of wheels alone.

        Who moves a keyframe there moves all that hangs on it.
        """
        odometry = self.odometry
        return None if isinstance(odometry, AnyWheelOdometry) else odometry.store

    @property
    def loops(self) -> LoopsBeside | None:
        """Closes loops while driving, with `loops: {source: keyframes}` and a camera; else None."""
        return self._way.loops if isinstance(self._way, ByFrames | ByFusion) else None

    @property
    def recognised(self) -> int | None:
        """How often something of the map of before was recognised so far; None without one. See `LiveLoops`."""
        return None if self.loops is None else self.loops.recognised

    @property
    def T_odom_map(self) -> FloatArray:
        """(4, 4) where the map lies: the identity where one odometry is followed, and no loop is closed.

        Joined with wheels, a pose T_odom_body gets better by what no camera shows, such as the floor that is level;
        the map stays as it is. Within the map the body is at `inv(T_odom_map) @ T_odom_body`.
        """
        return np.eye(4) if isinstance(self._way, ByWheels | ByPlaces) else self._way.T_odom_map

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sensors that are not used or were found wrong, and where clocks leapt; one sentence each."""
        of_sensors = () if isinstance(self._way, ByFrames) else self._way.warnings
        return (*self._unused.values(), *of_sensors, *self._clock.warnings)

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long each stage of the last frame took; none of a wheel reading."""
        return self._way.stage_seconds

    @ends
    def close(self) -> None:
        """End the threads that work for it, at the end of a run; may be called twice. What it knows stays.

        Raises what went wrong in them, and ArgumentError while an event is processed in another thread.
        """
        if self.keyframes is not None:
            self.keyframes.close()
        if self.loops is not None:
            self.loops.close()

    def __enter__(self) -> Localizer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @one_at_a_time
    def process(self, event: Event) -> Estimate | None:
        """The estimate at an event that is answered, None at any other; events that are not used are warned of once.

        A frame that could not be read, or that is not newer than the one before, counts as one that failed:
        it gives no pose, its reason is `FRAME_UNUSABLE`, and `note` says what was wrong with it. Beside wheels, which
        know the pose all the same, an unreadable frame or one without depth is no measurement: `note` says so.

        An image that came before under another stamp, as of a camera that is logged at twice its rate, is no
        measurement either; its reason is `REPEATED`, and all goes on as if it had not come. A camera alone that gives
        one image for over a second hangs: then frames count as failed, for the robot may be moving.

        Each stamp passes a `SessionClock`: where clocks leap while others go on, or all of them, the way goes on; what
        is stamped far from all others is refused, with a reason and a note.

        Raises:
            ArgumentError: no event, stamps that are no seconds, images of another shape or type than the calibration's,
                or depth that is not in metres. A call beside another one, in a forked process, or after `close`.
            PlaceError: a frame of another size than the model of places was trained on.
            PartError: a part of your own raised an exception, or answered what is no answer.
        """
        check_event(event)
        if isinstance(event, RgbdFrame) and RgbdFrame in self.hears:
            check_images(event, self._calibration, of_any_size=self._has_places)
        self.note = ""
        if not isinstance(event, self.hears):
            self._warn_unused(event)
            return None
        self._stamps.check(event)
        time_s = self._clock.time_of(event)
        if isinstance(time_s, Untimed):
            told = replace(event, stamp_s=event.stamp_s - self._clock.shift_s)
            estimate, self.note = self._way.refuse(told, time_s)
        else:
            timed = event if time_s == event.stamp_s else replace(event, stamp_s=time_s)
            timed = self._images.frame(timed) if isinstance(timed, RgbdFrame) else timed
            estimate, self.note = self._way.process(timed)
        if isinstance(self._way, ByWheels) and isinstance(estimate, WheelEstimate):
            estimate = self._way.in_odom(estimate)
        if self._resting is not None:
            self._resting.look()
        self._log.look(estimate, self.note, self.recognised, self.warnings)
        shift_s = self._clock.shift_s
        return estimate if estimate is None or not shift_s else replace(estimate, stamp_s=estimate.stamp_s + shift_s)

    def _warn_unused(self, event: Event) -> None:
        what = next(what for kind, what in _KINDS.items() if isinstance(event, kind))
        if what not in self._unused:
            self._unused[what] = why_unused(what, self._config, self._choice)
            self._log.warn(self.warnings)


class _Log:
    """Records of the logger: warnings, changes of status, recognised places, and frames that gave no measurement.

    Args:
        name: of the odometry, for several localizers of one run.
    """

    def __init__(self, name: str) -> None:
        self._name, self._status, self._recognised, self._warned = name, Status.INITIALIZING, 0, set[str]()

    def look(self, estimate: Estimate | None, note: str, recognised: int | None, warnings: tuple[str, ...]) -> None:
        """An event was answered."""
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
        """Log what was not logged before; a number that has changed makes no other warning."""
        for sentence in warnings:
            kind = _NUMBER.sub("", sentence)
            if kind not in self._warned:
                self._warned.add(kind)
                _LOG.warning(sentence)


def _joined(
    calibration: Calibration,
    settings: Config,
    places: Places | None,
    known: KnownMap | None,
    parts: OwnParts,
    *,
    waits: bool,
) -> ByFusion | ByLigocki:
    if settings.fusion.filter == "ligocki":
        return ByLigocki(calibration, settings, parts)
    if settings.places.model is None:
        return ByFusion(calibration, settings, known=known, waits=waits, parts=parts)
    return ByFusion(calibration, settings, places or load_places(settings.places), known, waits=waits, parts=parts)


# SmallerImages: frames halved before anything looks at them, for computers that are slow.


class SmallerImages:
    """Halves the images of both cameras until they are wide enough and no wider.

    Args:
        calibration: of frames as they come.
        most_width_px: an image wider than this is halved; None leaves all as they are.
        depth_jump: share of a depth that tells two surfaces apart, for depth is not averaged over both.

    Attributes:
        calibration: of frames as they leave.
    """

    def __init__(self, calibration: Calibration, most_width_px: int | None, depth_jump: float) -> None:
        self._color_halvings = _halvings(calibration.color, most_width_px)
        self._depth_halvings = _halvings(calibration.depth, most_width_px)
        self._jump, self._rows = depth_jump, Rows(1)
        self.calibration = calibration
        if calibration.color is not None and calibration.depth is not None:
            self.calibration = replace(
                calibration,
                color=calibration.color.halved(self._color_halvings),
                depth=calibration.depth.halved(self._depth_halvings),
                color_sigma_px=calibration.color_sigma_px / 2**self._color_halvings,
            )

    def frame(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame with smaller images."""
        if not (self._color_halvings or self._depth_halvings):
            return frame
        return replace(frame, color=self._color(frame.color), depth_m=self._depth(frame.depth_m))

    def in_full(self, matches: MatchedPixels | None) -> MatchedPixels | None:
        """Pixels of smaller colour images as those of the frames that came."""
        if matches is None or not self._color_halvings:
            return matches
        return replace(matches, px=self._in_full(matches.px), reference_px=self._in_full(matches.reference_px))

    def _color(self, color: ByteArray) -> ByteArray:
        if not self._color_halvings:
            return color
        height, width = (size >> self._color_halvings for size in color.shape[:2])
        whole = color[: height << self._color_halvings, : width << self._color_halvings]
        return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def _depth(self, depth_m: Float32Array) -> Float32Array:
        for halving in range(self._depth_halvings):
            # The same slope is twice the step from pixel to pixel.
            depth_m = halved_depth(depth_m, self._jump * (1 << halving), self._rows)
        return depth_m

    def _in_full(self, px: FloatArray) -> FloatArray:
        return np.asarray((px + 0.5) * 2**self._color_halvings - 0.5)


def _halvings(camera: PinholeCamera | None, most_width_px: int | None) -> int:
    times = 0
    while camera is not None and most_width_px is not None and camera.width >> times > most_width_px:
        times += 1
    return times


# RestingKeyframes: keyframes of a drive that writes no map rest in a temporary file, as they are.


_LOST = "the disk is full or gone: free some, or drive on without this keyframe"


class RestingKeyframes:
    """Bounds the memory of a store whose keyframes nobody writes to a map; what comes back is the same to the last bit.

    A keyframe goes once so many newer ones follow. Where the file cannot be written, all stay in memory from then on.

    Args:
        store: of the odometry.
        memory_keyframes: see `KeyframeStore.hold`.
        folder: in which the file is made once it is needed; None for the system's.
    """

    def __init__(self, store: KeyframeStore, memory_keyframes: int, folder: StrPath | None = None) -> None:
        self._store, self._most, self._folder = store, memory_keyframes, folder
        self._next = len(store)  # those before are of a map, which has them
        self._file: BinaryIO | None = None
        self._end, self._has_disk = 0, True

    def look(self) -> None:
        """Take what a frame has added to the store."""
        while self._has_disk and not self._store.is_written and self._next < len(self._store) - self._most:
            number, self._next = KeyframeId(self._next), self._next + 1
            try:
                keyframe = self._store[number]
            except Exception:  # whatever went wrong in making it: the store tells who asks for it
                continue
            try:
                self._put(number, keyframe)
            except OSError:
                self._has_disk = False

    def _put(self, number: KeyframeId, keyframe: Keyframe) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - as long as the store may read
            weakref.finalize(self._store, self._file.close)
            self._store.hold(self._most)
        arrays = _arrays_of(keyframe)
        self._file.seek(self._end)
        for array in arrays:
            self._file.write(array.tobytes())
        self._file.flush()
        like = [(array.dtype, array.shape) for array in arrays]
        self._store.rest(number, partial(_read, self._file, self._end, like))
        self._end = self._file.tell()


def resting_keyframes(store: KeyframeStore | None, settings: LocalizerSettings) -> RestingKeyframes | None:
    """What bounds a store's memory by the settings; None without a store, or where all are to stay."""
    if store is None or settings.memory_keyframes is None:
        return None
    return RestingKeyframes(store, settings.memory_keyframes, settings.resting_folder)


def _arrays_of(keyframe: Keyframe) -> list[NDArray[np.generic]]:
    """Numbers of all that it has; of features and code nothing where there are none."""
    images = [np.frombuffer(png, np.uint8) for png in (keyframe.depth_png, keyframe.grey_png)]
    features, code = keyframe.features, keyframe.code
    arrays: list[NDArray[np.generic]] = [np.array([keyframe.stamp_s]), keyframe.intrinsics, *images]
    arrays += [np.zeros(0) if code is None else code]
    return arrays if features is None else [*arrays, features.px, features.points, features.descriptors]


def _read(file: BinaryIO, begin: int, like: list[tuple[np.dtype[np.generic], tuple[int, ...]]]) -> Keyframe:
    """What `_arrays_of` told. Raises MapError."""
    sizes = [dtype.itemsize * int(np.prod(shape)) for dtype, shape in like]
    try:
        data = os.pread(file.fileno(), sum(sizes), begin)  # from any thread, while another one writes
    except OSError as error:
        raise MapError(f"a keyframe cannot be read again: {error}", fix=_LOST) from error
    if len(data) != sum(sizes):
        raise MapError("a keyframe that rests on disk is cut off", fix=_LOST)
    ends = np.cumsum(sizes)
    parts = [
        np.frombuffer(data[end - size : end], dtype).reshape(shape)
        for end, size, (dtype, shape) in zip(ends, sizes, like, strict=True)
    ]
    (stamp_s,), intrinsics, depth, grey, code, *of_features = parts
    features = KeyframeFeatures(*of_features) if of_features else None
    return Keyframe(float(stamp_s), intrinsics, depth.tobytes(), grey.tobytes(), features, code if len(code) else None)
