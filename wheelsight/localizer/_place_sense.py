"""PlaceSense: the area that a frame shows, told to the default filter as a position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.events import RgbdFrame
from wheelsight.fusion import AreaRectifierSettings, ErrorStateFilter, FusedEstimate, PlaceMeter
from wheelsight.geometry import FloatArray, se3
from wheelsight.localizer.by_places import Places
from wheelsight.odometry.stopwatch import Stopwatch
from wheelsight.places import PlaceMatch, Unknown


class PlaceSense:
    """What a model of places is to a filter.

    Attributes:
        begin_s: nothing before it has a pose.
        last_place: what the model said of the last frame, or None where it was not asked.
    """

    def __init__(self, places: Places, settings: AreaRectifierSettings) -> None:
        self.begin_s = places.begin_s
        self.last_place: PlaceMatch | None = None
        self._model, self._T_odom_begin = places.model, places.T_odom_base
        self._settings = settings
        self._meter = PlaceMeter(places.areas, settings, area_shares=places.model.area_shares)
        self._stopwatch = Stopwatch()

    @property
    def stage_seconds(self) -> dict[str, float]:
        """How long naming the area of the last frame took, and measuring by it."""
        return self._stopwatch.seconds

    @property
    def start(self) -> tuple[FloatArray, FloatArray]:
        """T_odom_base (4, 4) at the start, and covariance (6, 6) of its left perturbation, as the rectifier has it."""
        s, Ad = self._settings, se3.adjoint(self._T_odom_begin)
        in_base = np.diag(np.square([s.position_sigma_m, s.position_sigma_m, 0.0, 0.0, 0.0, s.yaw_sigma_rad]))
        return self._T_odom_begin, Ad @ in_base @ Ad.T

    def forget(self) -> None:
        """The last frame is over."""
        self.last_place = None
        self._stopwatch.restart()

    def tell(self, frame: RgbdFrame, answer: FusedEstimate, to: ErrorStateFilter) -> FusedEstimate:
        """The answer to a frame after its place; what was wrong with the look stays said.

        Raises:
            PlaceError: a frame of another size than the model was trained on.
        """
        with self._stopwatch.stage("name the area"):
            self.last_place = match = self._model.predict(frame)
        if answer.T_odom_body is None or answer.covariance is None:
            return answer
        probabilities = None if match.reason is Unknown.NO_DEPTH else match.probabilities
        with self._stopwatch.stage("measure by the area"):
            told = self._meter.measure(answer.T_odom_body, answer.covariance, probabilities)
            if told is None:
                return answer
            placed = to.update_position(frame.stamp_s, *told)
        of_look = {name: getattr(answer, name) for name in ("reason", "nis", "matches", "inliers")}
        return replace(placed, **of_look)
