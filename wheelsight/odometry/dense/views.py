"""Views that a frame may be aligned with: keyframes, and what a map looks like from where the camera is expected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from wheelsight.geometry import FloatArray, se3
from wheelsight.keyframes import KeyframeId
from wheelsight.odometry.dense.grid import Gridder
from wheelsight.odometry.dense.reference import Reference, ReferenceMaker
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.dense.tracked import Tracked, moved
from wheelsight.odometry.features.extraction import Features
from wheelsight.odometry.state import TrackingState
from wheelsight.odometry.stopwatch import Stopwatch
from wheelsight.views import ReferenceModel

# So many keyframes, those used last, are held ready; of others depth and grey alone, of which they are made in 5 ms.
_AT_HAND = 6


@dataclass(eq=False)
class KnownView:
    """A view with a pose.

    Attributes:
        keyframe: of the store, with which the pose moves: itself, or another that it was found by.
        reference: what frames are aligned with.
        covariance: (6, 6) of the left perturbation (v, ω) of its pose.
        features: of the colour camera, rows straightened, where it is to be recognised by them; or None.
        turning_rad_s: (3,) how fast the camera turned there, in its own frame; nothing for a map's view.
    """

    keyframe: KeyframeId
    reference: Reference
    covariance: FloatArray
    features: Features | None = None
    turning_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    def with_motion(self, covariance: FloatArray) -> FloatArray:
        """The covariance (6, 6) of a pose that lies off this one by a motion with its covariance (6, 6)."""
        Ad = se3.adjoint(self.reference.T_map_reference)
        return np.asarray(self.covariance + Ad @ covariance @ Ad.T)

    def distance_m(self, T_map_camera: FloatArray) -> float:
        """How far a view from there (4, 4) is from this one; a turn by a radian counts as 1.5 m."""
        return float(se3.view_shift_m(se3.invert(self.reference.T_map_reference) @ T_map_camera))

    def move(self, T_new_old: FloatArray) -> None:
        """To where its keyframe has moved by (4, 4), from the left, in the map."""
        reference = self.reference
        reference.T_map_reference, self.covariance = moved(T_new_old, reference.T_map_reference, self.covariance)


class Views:
    """What is known of the place, as views to align with.

    Args:
        settings: how many keyframes are kept, and for how long one prediction serves.
        gridder, maker: give the ideal grid, and references on it.
        watch: counts the time of "predict".
        model: what predicts a view, if anything does.

    Attributes:
        keyframes: the one used longest ago first.
    """

    def __init__(
        self,
        settings: DenseSettings,
        gridder: Gridder,
        maker: ReferenceMaker,
        watch: Stopwatch,
        model: ReferenceModel | None = None,
    ) -> None:
        self._settings, self._gridder, self._maker, self._watch = settings, gridder, maker, watch
        self._model = model
        self._prediction: tuple[KnownView | None, int] = None, 0
        self.keyframes: list[KnownView] = []

    @property
    def has_model(self) -> bool:
        """Whether a map predicts what is to be seen."""
        return self._model is not None

    def refer_to(self, model: ReferenceModel | None) -> None:
        """From now on, have a model predict views, or none."""
        if model is not self._model:
            self._model, self._prediction = model, (None, 0)

    def move(self, T_new_old: FloatArray) -> None:
        """Keyframes have moved by (N, 4, 4), by number; the map has moved too, and is asked anew what it looks like."""
        for view in self.keyframes:
            view.move(T_new_old[view.keyframe])
        self.expect_nothing()

    def expect_nothing(self) -> None:
        """What was predicted is forgotten: for elsewhere, or for keyframes where they were."""
        self._prediction = None, 0

    def keep(self, keyframe: KnownView) -> list[KnownView]:
        """Keep a keyframe, or let it count as the newest again; answers with the oldest ones, which go."""
        if keyframe in self.keyframes:
            self.keyframes.remove(keyframe)
        self.keyframes.append(keyframe)
        going = self.keyframes[: -self._settings.kept_keyframes]
        del self.keyframes[: len(going)]
        return going

    def of_frame(self, tracked: Tracked) -> KnownView:
        """A tracked frame as a view."""
        reference = self._maker.of_frame(tracked.frame, tracked.T_map_camera)
        return KnownView(tracked.keyframe, reference, tracked.covariance, turning_rad_s=tracked.twist[3:])

    def nearest(self, T_map_camera: FloatArray) -> KnownView:
        """The keyframe whose view is nearest to one from there (4, 4)."""
        T_map_keyframe = np.array([keyframe.reference.T_map_reference for keyframe in self.keyframes])
        return self.keyframes[int(np.argmin(se3.view_shift_m(se3.invert(T_map_keyframe) @ T_map_camera)))]

    def lack(self, found: Tracked, *, is_helped: bool) -> bool:
        """Whether a frame is to become a keyframe: the last one shows too little of it; beside a map, by the way."""
        if not self.has_model:
            # Alone, a frame that only the one before could place is none: people's backs would carry the camera along.
            is_settled = found.is_by_keyframe or not is_helped
            return found.overlap < self._settings.keyframe_overlap or not is_settled
        nearest = self.nearest(found.T_map_camera)
        return nearest.distance_m(found.T_map_camera) > self._settings.keyframe_way_m

    def around(self, T_map_camera: FloatArray, state: TrackingState) -> Iterator[KnownView]:
        """What the model predicts, then the newest keyframe; after failures the nearest; once lost, others in turn."""
        for keyframe in self.keyframes[:-_AT_HAND]:
            keyframe.reference.forget()
        if self._model is not None:
            yield self._predicted(self._model, T_map_camera, afresh=state.failures > 0)
        yield self.keyframes[-1]
        if state.failures:
            yield self.nearest(T_map_camera)
        yield from self._in_turn(state)

    def familiar(self, T_map_camera: FloatArray, state: TrackingState) -> list[KnownView]:
        """Keyframes that a frame may show: the nearest, the newest, and once lost an older one in turn."""
        keyframes = [self.nearest(T_map_camera), self.keyframes[-1], *self._in_turn(state)]
        return list(dict.fromkeys(keyframes))

    def _in_turn(self, state: TrackingState) -> Iterator[KnownView]:
        if state.is_lost:
            yield self.keyframes[-1 - state.failures % len(self.keyframes)]

    def _predicted(self, model: ReferenceModel, T_map_camera: FloatArray, *, afresh: bool) -> KnownView:
        """What the model looks like from there; one view serves for some frames, while the camera is near."""
        known, served = self._prediction
        is_near = known is not None and known.distance_m(T_map_camera) < self._settings.predicted_way_m
        if known is None or afresh or not is_near or served >= self._settings.predicted_frames:
            with self._watch.stage("predict"):
                view = model.predict(T_map_camera, self._gridder.intrinsics, self._gridder.shape)
                reference = self._maker.of_view(view, T_map_camera, self._gridder.intrinsics)
            nearest = self.nearest(T_map_camera)
            known, served = KnownView(nearest.keyframe, reference, nearest.covariance), 0
        self._prediction = known, served + 1
        return known
