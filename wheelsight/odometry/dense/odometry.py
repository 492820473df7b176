"""DenseOdometry: the camera's pose by every pixel, frame by frame, or an honest word that it is lost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.checks import array_of, check_frame
from wheelsight.estimates import Estimate, MotionEstimate, Reason, Status
from wheelsight.events import RgbdFrame
from wheelsight.geometry import FloatArray, se3
from wheelsight.odometry._velocity import LONGEST_STEP_S
from wheelsight.odometry.dense._doubt import Doubt, is_astray
from wheelsight.odometry.dense._falloff import Falloff
from wheelsight.odometry.dense._tracked import Expected, Told, Tracked, expected, fine_share, implausible
from wheelsight.odometry.dense._two_ways import met
from wheelsight.odometry.dense._views import Views
from wheelsight.odometry.dense.alignment import Aligner, Step
from wheelsight.odometry.dense.grid import Gridder, GridFrame
from wheelsight.odometry.dense.keyframes import Keyframe, Witness
from wheelsight.odometry.dense.observability import Prior, judge
from wheelsight.odometry.dense.reference import ReferenceMaker
from wheelsight.odometry.dense.settings import DenseSettings
from wheelsight.odometry.features.extraction import Features
from wheelsight.odometry.stopwatch import Stopwatch
from wheelsight.threads import Rows
from wheelsight.views import ReferenceModel, Surface

_START_VARIANCE = 1e-12
# Of a frame's resolution, what a keyframe must have to show it: along a corridor a frame is 3 mm off at half of it, and
# 1 mm at this; and keypoints are recognised.
_FINE = 0.8
# After so long alone, most keypoints that match a view must agree on it: a part does in places that look alike.
_LONG_S = 2.0
# Rows placed more wrongly than this are worth preparing a frame twice; of one that is no keyframe, than the second.
_STRAIGHT_ENOUGH_PX = 0.3, 1.0


class DenseOdometry:
    """Aligns each frame with a keyframe, with the previous frame, or with what a map predicts.

    The first frame with depth starts the map. A turn is found first, by grey values alone; then depth and grey are
    aligned from coarse to fine. Directions of motion that the view does not show are left to the prior and named.
    A frame that fails is counted; after `lost_after` in a row the state is LOST, until a keyframe is recognised.

    Args:
        calibration: of the cameras.
        settings: or the defaults.
        model: what predicts the view to align with, if anything does.
        T_map_first: (4, 4) where the camera is at the first frame with depth; by default at the map's origin.

    Attributes:
        last_motion: of the last frame against its reference.
        last_frame: the last frame tracked, on the ideal grid, straightened; None where the last one failed.
        watch: stops the time of the last frame's "prepare", "predict", "align", "recognise" and "keyframe".
    """

    def __init__(
        self,
        calibration: Calibration,
        settings: DenseSettings | None = None,
        model: ReferenceModel | None = None,
        T_map_first: FloatArray | None = None,
    ) -> None:
        self._calibration, self._settings = calibration, settings or DenseSettings()
        rows = Rows(self._settings.threads)
        self._gridder = Gridder(calibration, self._settings, rows)
        self._maker = ReferenceMaker(calibration.depth_noise, self._settings, rows)
        self._aligner = Aligner(calibration, self._settings, rows, self._gridder, self._maker)
        self._witness = Witness(calibration)
        self.watch = Stopwatch()
        self._views = Views(self._settings, self._gridder, self._maker, self.watch, model)
        self._doubt = Doubt(self._settings)
        self._falloff = Falloff(self._gridder, self._settings)
        self._T_map_first = np.eye(4) if T_map_first is None else np.asarray(T_map_first, float)
        self._first: RgbdFrame | None = None
        self._last: Tracked | None = None
        self._failures = 0
        self.last_motion = MotionEstimate.failed(Reason.FRAME_UNUSABLE)
        self.last_frame: GridFrame | None = None

    @property
    def stage_seconds(self) -> dict[str, float]:
        """Seconds the last frame spent in each stage."""
        return self.watch.seconds

    @property
    def intrinsics(self) -> FloatArray:
        """fx, fy, cx, cy (4,) of the ideal camera on whose grid frames and predictions are."""
        return self._gridder.intrinsics

    @property
    def sees_all_motion(self) -> bool:
        """Whether the last frames showed every direction of motion; else part of the pose is only what was expected."""
        return self._doubt.unseen_s == 0

    def last_surface(self, frame: RgbdFrame, with_color: bool = True) -> Surface:
        """What `frame`, which was the last one tracked, adds to a map."""
        assert self.last_frame is not None, "the last frame has no pose"
        finest = self.last_frame.levels[0]
        color = self._gridder.color_on_grid(frame, self.last_frame) if with_color else None
        return Surface(finest.depth_m, self._maker.normals(finest), finest.grey, color)

    def process(
        self,
        frame: RgbdFrame,
        T_previous_current_prior: FloatArray | None = None,
        T_previous_current_other: FloatArray | None = None,
        *,
        twist: FloatArray | None = None,
    ) -> Estimate:
        """The camera's pose at a frame, T_map_camera, or why there is none. Raises ArgumentError for no frame.

        Args:
            frame: newer than the one before.
            T_previous_current_prior: (4, 4) expected motion of the camera since the last tracked frame, from wheels
                for instance; else constant velocity is expected.
            T_previous_current_other: (4, 4) what may be so instead, and is taken where it fits clearly better.
            twist: (6,) the camera's velocity (v, ω) in its own frame now, as others tell. It is asked for where the
                last frame is so long ago that the mean velocity since says little, and rows are exposed one by one.
        """
        check_frame(frame, self._calibration, prior=T_previous_current_prior, other=T_previous_current_other)
        if twist is not None:
            twist = array_of("twist", twist, (6,))
        self.watch.restart()
        self.last_frame = None
        last = self._last
        if last is None:
            self._first = frame
            return self._begin(frame, self._T_map_first, _START_VARIANCE * np.eye(6))
        told = Told(T_previous_current_prior, T_previous_current_other, twist)
        found = self._find(frame, last, told)
        is_blind = not isinstance(found, Tracked) and found.reason is Reason.TOO_LITTLE_DEPTH
        if not (isinstance(found, Tracked) or is_blind or T_previous_current_prior is None):
            # Wheels that spin expect what is not so, and lead astray.
            found = self._find(frame, last, replace(told, T_last_frame=None))
        return self._accept(found) if isinstance(found, Tracked) else self._fail(frame.stamp_s, found)

    def _find(self, frame: RgbdFrame, last: Tracked, told: Told) -> Tracked | MotionEstimate:
        """Where a frame is, from what others tell or constant velocity expects, or why that is not known."""
        ahead, twist = expected(last, frame.stamp_s, told)
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, twist)
        if grid.depth_share < self._settings.min_depth_share:
            return MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH)
        found = self._locate(grid, last, ahead)
        if isinstance(found, Tracked) and self._first is not None:
            found = self._begin_again(found, ahead)
        found = self._doubted(frame, last, found, grid, ahead)
        if isinstance(found, Tracked):
            with self.watch.stage("keyframe"):
                found = self._remember(frame, found, ahead)
        return found

    def miss(self, stamp_s: float) -> Estimate:
        """Count a frame that came to nothing before it reached odometry, as a failed one."""
        self.watch.restart()
        self.last_frame = None
        return self._fail(stamp_s, MotionEstimate.failed(Reason.FRAME_UNUSABLE))

    def refer_to(self, model: ReferenceModel | None) -> None:
        """Align frames from now on with what a model predicts that stands in this map, or with keyframes alone."""
        self._views.refer_to(model)

    def restart(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> Estimate:
        """Go on at a frame that shows nothing known, at a pose (4, 4) that others tell; what was known is kept."""
        check_frame(frame, self._calibration, T_map_camera=T_map_camera, covariance=covariance)
        self.watch.restart()
        self._first, self._doubt.unseen_s = None, 0.0
        return self._begin(frame, T_map_camera, covariance)

    def _begin(self, frame: RgbdFrame, T_map_camera: FloatArray, covariance: FloatArray) -> Estimate:
        with self.watch.stage("prepare"):
            grid = self._gridder.on_grid(frame, np.zeros(6))
        if grid.depth_share < self._settings.min_depth_share:
            return self._fail(frame.stamp_s, MotionEstimate.failed(Reason.TOO_LITTLE_DEPTH))
        start = Tracked(grid, T_map_camera, covariance)
        with self.watch.stage("keyframe"):
            self._views.begin(self._keyframe(start, self._witness.look(frame)))
        self.last_motion = MotionEstimate(np.eye(4), _START_VARIANCE * np.eye(6))
        return self._accept(start)

    def _begin_again(self, found: Tracked, ahead: Expected) -> Tracked | MotionEstimate:
        """Straighten the first frame too, now that the second tells the camera's speed, and locate the second anew."""
        first, self._first = self._first, None
        if first is None or self._last is None or not self._gridder.late_s.any():
            return found
        self._last = replace(self._last, frame=self._gridder.on_grid(first, found.twist), twist=found.twist)
        keyframe = self._keyframe(self._last, self._witness.look(first))
        self._views.keyframes[:] = [keyframe]
        return self._align(found.frame, keyframe, self._last, ahead, [found.T_map_camera])

    def _locate(self, grid: GridFrame, last: Tracked, ahead: Expected) -> Tracked | MotionEstimate:
        """Align with the first reference that fits, beginning at the best of the expected poses T_map_camera."""
        failure: MotionEstimate | None = None
        for place, view in enumerate(self._references(last, ahead)):
            is_elsewhere = place > 0 and self._is_lost
            begun = (view.reference.T_map_reference,) if is_elsewhere else ahead.T_map_camera
            found = self._align(grid, view, last, ahead, begun)
            if isinstance(found, Tracked):
                return self._seen_sharper(found, view, last, ahead)
            failure = failure or found
        assert failure is not None
        return failure

    def _references(self, last: Tracked, ahead: Expected) -> Iterator[Keyframe]:
        """Views from about there; while no frame has failed, the frame before too."""
        yield from self._views.around(ahead.T_map_camera[0], self._failures)
        if self._failures == 0:
            yield self._keyframe(last)

    def _seen_sharper(self, found: Tracked, by: Keyframe, last: Tracked, ahead: Expected) -> Tracked:
        """A pose by the map; by the frame before if only that shows all motion: a bare wall's marks fade in a map.

        Where neither does, constant velocity is held: a mark that fits another's place would pull along the wall.
        """
        motion = self.last_motion
        if not self._views.has_model or self._failures or motion.shows_all:
            return found
        for keyframe, is_held in [(self._keyframe(last), False), (by, True)][: 1 if ahead.is_helped else 2]:
            again = self._align(found.frame, keyframe, last, ahead, ahead.T_map_camera, is_held=is_held)
            if isinstance(again, Tracked) and (is_held or self.last_motion.shows_all):
                return again
        self.last_motion = motion
        return found

    @property
    def _is_lost(self) -> bool:
        return self._failures >= self._settings.lost_after

    def _align(
        self,
        grid: GridFrame,
        keyframe: Keyframe,
        last: Tracked,
        ahead: Expected,
        begun: Sequence[FloatArray],
        *,
        is_held: bool = False,
    ) -> Tracked | MotionEstimate:
        """Where a frame is by one view, begun at the best of some poses T_map_camera; or why that is not known."""
        reference, seconds = keyframe.reference, grid.stamp_s - last.frame.stamp_s
        T_reference_map = se3.invert(reference.T_map_reference)
        step = Step(T_reference_map @ last.T_map_camera, seconds) if seconds <= LONGEST_STEP_S else None
        sigma_m = self._settings.prior_sigma_m_s * max(seconds, 1e-3)
        # One's own guess is held only where nothing tells more: what noise pulls off is to betray itself by a leap.
        held_m = sigma_m if ahead.is_helped or is_held else np.inf, self._settings.nonholonomic_share * sigma_m
        with self.watch.stage("align"):
            starts = [self._aligner.start(grid, reference, [T_reference_map @ T for T in begun])]
            if ahead.T_map_other is not None:
                starts.append(self._aligner.turn(grid, reference, T_reference_map @ ahead.T_map_other))
            found = self._aligner.align_clearest(grid, reference, starts, step, held_m)
        first, *others = (T_reference_map @ T for T in ahead.T_map_camera)
        judged = judge(found, Prior(first, sigma_m, tuple(others)), self._settings)
        T_map_camera = se3.nearest(reference.T_map_reference @ judged.T_reference_frame)
        reason = judged.reason or implausible(last, T_map_camera, seconds, self._settings)
        if reason is not None:
            return MotionEstimate.failed(reason, found.pairs, found.planes)
        counts = (None, found.pairs, found.planes, judged.degenerate)
        self.last_motion = MotionEstimate(judged.T_reference_frame, judged.covariance, *counts)
        twist = step.twist_to(judged.T_reference_frame) if step else grid.twist
        overlap = found.planes / max(found.points, 1) * fine_share(grid, judged.T_reference_frame, _FINE)
        fit = (overlap, keyframe in self._views.keyframes, found.residual)
        return Tracked(grid, T_map_camera, keyframe.with_motion(judged.covariance), twist, *fit)

    def _doubted(
        self, frame: RgbdFrame, last: Tracked, found: Tracked | MotionEstimate, grid: GridFrame, ahead: Expected
    ) -> Tracked | MotionEstimate:
        """A pose by surfaces alone is kept while they show all motion and fit as usual, and without a leap.

        Else, and after a failure or a gap, keypoints must say the same; where they know better, theirs is the pose. A
        prior stands in for what surfaces do not show, and for keypoints after a failure, or a gap that it bridges. Off
        the prior, they are asked too, for people who walk by may carry a pose along; but wheels may slip where no
        keypoint tells anything.
        """
        seconds, is_alone = grid.stamp_s - last.frame.stamp_s, not ahead.is_helped
        if isinstance(found, Tracked):
            if is_alone and self._failures == 0:
                self._doubt.count(seconds, shows_all=self.last_motion.shows_all)
            if ahead.is_helped and self.last_motion.shows_all and self._doubt.is_bridged(found, ahead, seconds):
                return found
            is_steady = ahead.is_helped or bool(last.twist.any())
            is_doubtful = self._doubt.falls_on(found, seconds, is_alone=is_alone, is_steady=is_steady)
            if not is_doubtful and ahead.is_helped and is_astray(found):
                return self._witnessed(frame, last, found, grid, ahead, is_needed=self._failures > 0)
            if not is_doubtful and (ahead.is_helped or self._failures == 0):
                return found
        return self._witnessed(frame, last, found, grid, ahead)

    def _witnessed(
        self,
        frame: RgbdFrame,
        last: Tracked,
        found: Tracked | MotionEstimate,
        grid: GridFrame,
        ahead: Expected,
        *,
        is_needed: bool = True,
    ) -> Tracked | MotionEstimate:
        """A pose that keypoints agree with: as it was found, found again from where they say, or theirs.

        Unless they are needed, it is kept as well where too few of them tell anything.
        """
        with self.watch.stage("recognise"):
            T_guess = found.T_map_camera if isinstance(found, Tracked) else last.T_map_camera
            features, familiar = self._witness.look(frame), self._views.familiar(T_guess, self._failures)
            told = self._witness.locate(features, familiar, grid.twist)
        if not is_needed and (told is None or not told.is_likely):
            return found
        is_anywhere = grid.stamp_s - last.frame.stamp_s > _LONG_S and not ahead.is_helped
        if told is None or (is_anywhere and not told.is_likely):
            missing = Reason.DEGENERATE if self._doubt.is_blind and not ahead.is_helped else Reason.NOT_RECOGNISED
            return MotionEstimate.failed(missing) if isinstance(found, Tracked) else found
        if not isinstance(found, Tracked) or not told.agrees_with(found.T_map_camera):
            found = self._locate(grid, last, ahead.at(told.T_map_camera))
            if isinstance(found, Tracked) and not told.agrees_with(found.T_map_camera):
                # The rolling shutter bends keypoints by the speed expected; surfaces have corrected it.
                told = self._witness.locate(features, familiar, found.twist) or told
        if not (isinstance(found, Tracked) and told.agrees_with(found.T_map_camera)):
            if not told.is_clear:
                return MotionEstimate.failed(Reason.SURFACES_CONTRADICTED, told.matches, told.inliers)
            # Between two frames keypoints err by more than a camera's speed changes.
            found = Tracked(grid, se3.nearest(told.T_map_camera), told.covariance, grid.twist)
            self.last_motion = told.motion_from(self._views.nearest(told.T_map_camera).reference.T_map_reference)
        self._doubt.unseen_s = 0.0  # keypoints show all motion
        return found

    def _remember(self, frame: RgbdFrame, found: Tracked, ahead: Expected) -> Tracked | MotionEstimate:
        """Keep the frame as a keyframe where it shows much that the last one did not; keypoints must not gainsay it."""
        if self._settings.reference == "previous" and not self._views.has_model:
            straight = self._straightened(frame, found)
            self._views.keyframes[:] = [self._keyframe(straight, self._witness.look(frame))]
            return straight
        if not self._views.lack(found, is_helped=ahead.is_helped):
            return self._straightened(frame, found, is_kept=False)
        seen = self._seen_from_before(found, ahead)
        if seen is not None:
            return seen
        straight = self._straightened(frame, self._told_by_two(found, ahead))
        features = self._witness.look(frame)
        told = self._witness.locate(features, self._views.keyframes[-1:], found.twist)
        if told is not None and not told.agrees_with(found.T_map_camera) and (told.is_clear or not ahead.is_helped):
            return MotionEstimate.failed(Reason.SURFACES_CONTRADICTED)
        self._falloff.learn(straight.frame, straight.T_map_camera, self._views.keyframes[-1].reference)
        self._views.keep(self._keyframe(straight, features))
        return straight

    def _seen_from_before(self, found: Tracked, ahead: Expected) -> Tracked | None:
        """The frame by an older keyframe that is nearer and shows the same, which ends the drift, if there is one."""
        nearest = self._views.nearest(found.T_map_camera)
        if self._views.has_model or nearest is self._views.keyframes[-1] or self._last is None:
            return None
        motion = self.last_motion
        here = ahead.at(found.T_map_camera)
        seen = self._align(found.frame, nearest, self._last, here, here.T_map_camera)
        if isinstance(seen, Tracked) and seen.overlap > self._settings.keyframe_overlap:
            self._views.keep(nearest)
            return seen
        self.last_motion = motion
        return None

    def _told_by_two(self, found: Tracked, ahead: Expected) -> Tracked:
        """The frame by the keyframe before the last one, too, where no map ties keyframes together."""
        before = self._views.keyframes[-2:-1]
        if not before or self._views.has_model or self._last is None or not found.is_by_keyframe:
            return found
        short, here = self.last_motion, ahead.at(found.T_map_camera)
        seen = self._align(found.frame, before[0], self._last, here, here.T_map_camera)
        long, self.last_motion = self.last_motion, short
        if not isinstance(seen, Tracked):
            return found
        return replace(found, T_map_camera=met(found.T_map_camera, short, seen.T_map_camera, long))

    def _straightened(self, frame: RgbdFrame, found: Tracked, *, is_kept: bool = True) -> Tracked:
        """The same frame, its rows straightened by the speed that was found rather than the one expected."""
        wrong = np.abs(found.twist - found.frame.twist)[3:].max() * np.abs(self._gridder.late_s).max()
        if wrong * self.intrinsics[0] < _STRAIGHT_ENOUGH_PX[0 if is_kept else 1]:
            return found
        return replace(found, frame=self._gridder.on_grid(frame, found.twist))

    def _keyframe(self, tracked: Tracked, features: Features | None = None) -> Keyframe:
        T, covariance = tracked.T_map_camera, tracked.covariance
        view = None if features is None else self._witness.view(features, T, covariance, tracked.twist)
        return Keyframe(self._maker.of_frame(tracked.frame, T), covariance, view)

    def _accept(self, found: Tracked) -> Estimate:
        self._last, self._failures, self.last_frame = found, 0, found.frame
        self._doubt.learn(found)
        motion, pose = self.last_motion, (found.T_map_camera, found.covariance)
        return Estimate(found.frame.stamp_s, Status.TRACKING, *pose, matches=motion.matches, inliers=motion.inliers)

    def _fail(self, stamp_s: float, failure: MotionEstimate) -> Estimate:
        self._failures += 1
        self.last_motion = failure
        status = Status.INITIALIZING
        if self._last is not None:
            status = Status.LOST if self._is_lost else Status.FAILING
            self._last = replace(self._last, twist=np.zeros(6))
        return Estimate(stamp_s, status, reason=failure.reason, matches=failure.matches, inliers=failure.inliers)
