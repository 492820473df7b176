"""ByPlaces: localization by wheels and recognized areas.

`PlaceSense` turns recognized areas into position measurements of the error-state filter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from wheelsight.config import Config, PlaceSettings
from wheelsight.core.areas import AreaMap, load_areas
from wheelsight.core.calibration import Calibration
from wheelsight.core.checks import Repeats, Untimed
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import (
    NO_DECISION,
    Estimate,
    FusedEstimate,
    PoseFinding,
    Reason,
    WheelEstimate,
    status_of,
)
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import WHEEL_READINGS, Event, RgbdFrame, SkippedFrame
from wheelsight.core.settings.fusion import AreaRectifierSettings
from wheelsight.core.threads import Stopwatch
from wheelsight.estimation.area_rectifier import AreaRectifier, PlaceMeter
from wheelsight.estimation.filter import ErrorStateFilter
from wheelsight.estimation.wheel_localizer import ByWheels
from wheelsight.places import PlaceMatch, PlaceModel, Unknown
from wheelsight.wheels import AnyWheelOdometry


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Model, areas and start of a localization by areas.

    Attributes:
        model: recognizes the area of a frame.
        areas: of its training, in the map frame.
        T_odom_base: (4, 4) planar pose of the base at the first reading from `begin_s` on.
        begin_s: readings and frames before it have no pose.
    """

    model: PlaceModel
    areas: AreaMap
    T_odom_base: FloatArray
    begin_s: float = -np.inf


def load_places(
    settings: PlaceSettings,
    areas: StrPath | None = None,
    T_odom_base: FloatArray | None = None,
    begin_s: float = -np.inf,
) -> Places:
    """Read model and areas. Settings take precedence over arguments.

    Raises:
        ConfigError: no model, no areas, or no start.
        AreaError, PlaceError: an invalid file, or a model of other areas.
    """
    areas = None if areas is None else Path(areas)
    if settings.model is None:
        raise ConfigError("no model of places is given", fix="places: {model: FILE}, from wheelsight places train")
    path = areas if settings.areas is None else Path(settings.areas)
    if path is None:
        raise ConfigError("no areas are given", fix="places: {areas: FILE}, the areas.yaml of the model")
    if settings.start is not None:
        T_odom_base, begin_s = settings.start.T_odom_base, -np.inf
    if T_odom_base is None:
        raise ConfigError("where the robot starts in the map is not known", fix="give --start X,Y,YAW_DEG")
    area_map = load_areas(path)
    return Places(PlaceModel.load(Path(settings.model), areas=area_map), area_map, T_odom_base, begin_s)


class ByPlaces:
    """Answers wheel readings and frames by the wheels' pose, which each frame corrects by its area.

    Attributes:
        last_place: result of the model for the last frame; None if it was not asked.
    """

    body, frame, answers = "base", "map", (*WHEEL_READINGS, RgbdFrame, SkippedFrame)
    last_matches = loops = mapper = keyframes = None

    def __init__(self, calibration: Calibration, settings: Config, places: Places) -> None:
        self._wheels = ByWheels(calibration, settings.wheels)
        self.hears: tuple[type[Event], ...] = (*self._wheels.hears, RgbdFrame, SkippedFrame)
        self.last_place: PlaceMatch | None = None
        self.T_odom_map: FloatArray = np.eye(4)
        self._model, self._begin_s = places.model, places.begin_s
        self._rectifier: _Rectifier
        if settings.places.rectify == "paper":
            from wheelsight_papers.paper_rectifier import ByPaper

            self._rectifier = ByPaper(places, settings.places)
        else:
            self._rectifier = _ByProbability(places, settings.fusion.areas)
        assert calibration.any_wheels is not None  # ByWheels has refused it
        self._max_gap_s = calibration.any_wheels.max_gap_s
        self._reading_s = -np.inf
        self._repeats = Repeats()
        self.watch = Stopwatch()

    @property
    def odometry(self) -> AnyWheelOdometry:
        """Odometry of the wheels, with the gyroscope while that is trusted."""
        return self._wheels.odometry

    @property
    def warnings(self) -> tuple[str, ...]:
        """Fault of the gyroscope, as a sentence."""
        return self._wheels.warnings

    def process(self, event: Event) -> tuple[Estimate | None, str]:
        """Return the estimate at a reading or frame, None at any other event, and why a frame is no measurement."""
        if isinstance(event, RgbdFrame | SkippedFrame):
            self.watch.restart()
            self.last_place = None
            why_not = self._why_not(event)
            if why_not is not None:
                return why_not
            return self._correct(event)
        reading, note = self._wheels.process(event)
        return (None if reading is None else self._reading(reading)), note

    def refuse(self, event: Event, why: Untimed) -> tuple[Estimate | None, str]:
        """Return the estimate at an event with an invalid stamp; None at a yaw rate."""
        self.last_place = None
        if isinstance(event, RgbdFrame | SkippedFrame):
            status = status_of(PoseFinding.FRAME_FAILED)
            failed = Estimate(event.stamp_s, status, reason=Reason.FRAME_UNUSABLE, body=self.body)
            return failed, f"no measurement: {why.note}"
        reading, note = self._wheels.refuse(event, why)
        return (None if reading is None else self._reading(reading)), note

    def _reading(self, wheels: WheelEstimate) -> Estimate:
        if wheels.stamp_s < self._begin_s:
            return Estimate(wheels.stamp_s, NO_DECISION.status, body=self.body)
        self._rectifier.predict(wheels)
        if wheels.reason is not Reason.CLOCK_BACKWARDS:
            self._reading_s = wheels.stamp_s
        rectified = self._rectifier.estimate(wheels.stamp_s)
        return replace(rectified, status=wheels.status, reason=wheels.reason)

    def _why_not(self, frame: RgbdFrame | SkippedFrame) -> tuple[Estimate, str] | None:
        """Return the estimate at a frame without a current pose of the wheels, else None."""
        if self._reading_s == -np.inf:
            return Estimate(frame.stamp_s, NO_DECISION.status, body=self.body), "no wheel reading yet"
        if frame.stamp_s > self._reading_s + self._max_gap_s:
            note = f"the last wheel reading is {frame.stamp_s - self._reading_s:.3f} s old"
            status = status_of(PoseFinding.FRAME_FAILED)
            return replace(self._rectifier.estimate(frame.stamp_s), status=status, reason=Reason.GAP), note
        return None

    def _correct(self, frame: RgbdFrame | SkippedFrame) -> tuple[Estimate, str]:
        if isinstance(frame, SkippedFrame):
            return self._predicted(self._rectifier.estimate(frame.stamp_s)), f"no measurement: {frame.reason}"
        if self._repeats.lasting_s(frame) > 0:  # would count twice
            again = replace(self._rectifier.estimate(frame.stamp_s), reason=Reason.REPEATED)
            return self._predicted(again), "no measurement: the same image as before"
        self.watch.lap("check")
        with self.watch.stage("name the area"):
            self.last_place = match = self._model.predict(frame)
        with self.watch.stage("rectify"):
            rectified = self._rectifier.correct(frame.stamp_s, match)
        return self._predicted(rectified), f"no measurement: {match.reason}" if match.reason is Unknown.NO_DEPTH else ""

    def _predicted(self, estimate: Estimate) -> Estimate:
        """Predict an estimate of the last reading at the stamp of its frame, by the wheels' velocity."""
        assert estimate.T_odom_body is not None  # rectifiers always have one
        T_reading_frame = self.odometry.motion_in(max(estimate.stamp_s - self._reading_s, 0.0))
        return replace(estimate, T_odom_body=estimate.T_odom_body @ T_reading_frame)


class _Rectifier(Protocol):
    """A method that corrects wheels by areas."""

    def predict(self, wheels: WheelEstimate) -> None:
        """Predict by the next estimate of the wheels; the first one is the start."""

    def correct(self, stamp_s: float, match: PlaceMatch) -> Estimate:
        """Return the pose at a frame, corrected by its area."""

    def estimate(self, stamp_s: float) -> Estimate:
        """Return the pose between frames."""


class _ByProbability:
    def __init__(self, places: Places, settings: AreaRectifierSettings) -> None:
        self._inner = AreaRectifier(places.areas, places.T_odom_base, settings, area_shares=places.model.area_shares)

    def predict(self, wheels: WheelEstimate) -> None:
        self._inner.predict_to(wheels)

    def correct(self, stamp_s: float, match: PlaceMatch) -> Estimate:
        return self._inner.update(stamp_s, None if match.reason is Unknown.NO_DEPTH else match.probabilities)

    def estimate(self, stamp_s: float) -> Estimate:
        return self._inner.estimate(stamp_s)


class PlaceSense:
    """Measures positions by recognized areas, for a filter.

    Attributes:
        begin_s: events before it have no pose.
        last_place: result of the model for the last frame; None if it was not asked.
    """

    def __init__(self, places: Places, settings: AreaRectifierSettings, watch: Stopwatch) -> None:
        self.begin_s = places.begin_s
        self.last_place: PlaceMatch | None = None
        self._model, self._T_odom_begin = places.model, places.T_odom_base
        self._settings, self._watch = settings, watch
        self._meter = PlaceMeter(places.areas, places.model.area_shares)

    @property
    def start(self) -> tuple[FloatArray, FloatArray]:
        """T_odom_base (4, 4) at the start, and covariance (6, 6) of its left perturbation."""
        s, Ad = self._settings, se3.adjoint(self._T_odom_begin)
        in_base = np.diag(np.square([s.position_sigma_m, s.position_sigma_m, 0.0, 0.0, 0.0, s.yaw_sigma_rad]))
        return self._T_odom_begin, Ad @ in_base @ Ad.T

    def forget(self) -> None:
        """Forget the result of the last frame."""
        self.last_place = None

    def update(self, frame: RgbdFrame, answer: FusedEstimate, to: ErrorStateFilter) -> FusedEstimate:
        """Update the filter by the area of a frame; return the estimate, with reason and counts of `answer`.

        Raises:
            PlaceError: a frame of another size than the model was trained on.
        """
        with self._watch.stage("name the area"):
            self.last_place = match = self._model.predict(frame)
        if answer.T_odom_body is None or answer.covariance is None:
            return answer
        probabilities = None if match.reason is Unknown.NO_DEPTH else match.probabilities
        with self._watch.stage("measure by the area"):
            position = self._meter.measure(answer.T_odom_body, answer.covariance, probabilities)
            if position is None:
                return answer
            placed = to.update_position(frame.stamp_s, *position)
        of_camera = {name: getattr(answer, name) for name in ("reason", "nis", "matches", "inliers")}
        return replace(placed, **of_camera)
