"""CameraMap: the frame in which camera odometry has its poses, and where it lies in odom.

What the filter knows better moves the pose but no surfel, which would tear the map: so the map as a whole is moved to
where the camera's last believed pose in it is the one that is known of its frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from wheelsight.core.camera_errors import with_frame_error
from wheelsight.core.estimates import DEGENERATE_SCALE, Estimate, FusedEstimate, MotionEstimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.geometry import motion_kernels as motions
from wheelsight.core.keyframes import KeyframeId


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """The frame against which the camera's motions are told to the filter: its pose T_map_camera (4, 4) by odometry.

    `covariance` (6, 6) is what its alignment left uncertain, in its own frame: all motions told against it share that.
    """

    T_map_camera: FloatArray
    covariance: FloatArray

    @classmethod
    def at(cls, T_map_camera: FloatArray, motion: MotionEstimate) -> Anchor:
        """A frame at a pose, which `motion` against its own reference has told."""
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        return cls(T_map_camera, motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))

    def motion_to(self, T_map_camera: FloatArray, motion: MotionEstimate) -> MotionEstimate:
        """The motion from here to a pose that odometry found by `motion` against a reference of its own.

        Its covariance is what the last alignment left uncertain; directions that this did not show are named.
        """
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        T_anchor_camera = motions.mended(motions.times(motions.inverse(self.T_map_camera), T_map_camera))
        T_anchor_reference = motions.times(T_anchor_camera, motions.inverse(motion.T_reference_current))
        covariance, hidden = motions.carried(T_anchor_reference, motion.covariance), None
        if motion.degenerate is not None and not motion.shows_all:
            Ad = motions.adjoint(T_anchor_reference)
            hidden = np.linalg.qr(((motion.degenerate / DEGENERATE_SCALE) @ Ad.T * DEGENERATE_SCALE).T)[0].T
        return MotionEstimate(T_anchor_camera, covariance, None, motion.matches, motion.inliers, hidden, motion.fitting)


# The camera has left its map where the filter has it so far from there, metres; a turn by a radian counts as 1.5 m.
# Wheels that the filter has believed meanwhile err by less in the second or two that a contradiction lasts.
_LEFT_MAP_M = 0.15
# A camera that has seen nothing for longer, seconds, may be right where wheels have drifted meanwhile.
_LONGEST_GAP_S = 0.5


class CameraMap:
    """See the module.

    Attributes:
        T_odom_map: (4, 4) where the map, of the camera and its surfels, lies by now.
        anchor: the frame against which the camera's motions are told to the filter; None before the camera begins.
        seen_s: stamp of the last frame that was believed.
        keyframe: by which the camera remembers it.

    Args:
        T_base_camera: (4, 4).
        T_map_camera: (4, 4) where the camera is at first, while the base is at the origin of odom; None: the map
            begins there.
    """

    def __init__(self, T_base_camera: FloatArray, T_map_camera: FloatArray | None = None) -> None:
        self.T_odom_map: FloatArray = np.eye(4)
        self.anchor: Anchor | None = None
        self.seen_s = -np.inf
        self._T_base_camera = T_base_camera
        self._T_map_odom: FloatArray = np.eye(4)
        if T_map_camera is not None:
            self._lay(T_base_camera, T_map_camera)
        self._T_map_camera: FloatArray | None = None  # at the last frame, where that was believed
        self.keyframe: KeyframeId | None = None
        self._T_keyframe_map: FloatArray | None = None
        self._tracked_s, self._is_contradicted = -np.inf, False

    def forget_frame(self) -> None:
        """The last frame is over."""
        self._T_map_camera = None

    def track(self, stamp_s: float, *, is_believed: bool) -> None:
        """Take that a frame was tracked, and whether the filter believes it."""
        if not is_believed and stamp_s - self._tracked_s <= _LONGEST_GAP_S:
            self._is_contradicted = True
        self._tracked_s = stamp_s

    def is_left(self, T_map_camera: FloatArray, T_odom_base: FloatArray | None) -> bool:
        """Whether the camera at a pose (4, 4) has left the map, by what the filter has decided about the base.

        The filter has refused frames that followed each other, and believes the next ones: the camera leapt, as it does
        by a period of paint that repeats. The map would leap along if it were laid to where the camera now is in it.
        """
        if not self._is_contradicted or T_odom_base is None:
            return False
        T_odom_camera = motions.times(T_odom_base, self._T_base_camera)
        by_map = motions.times(self.T_odom_map, T_map_camera)
        return bool(motions.view_shift_m(motions.times(motions.inverse(by_map), T_odom_camera)) > _LEFT_MAP_M)

    def believe(self, stamp_s: float, T_map_camera: FloatArray, T_odom_base: FloatArray | None) -> None:
        """A frame is where the camera has it in the map, and the base was at a pose when its image was taken."""
        self._T_map_camera, self.seen_s = T_map_camera, stamp_s
        self._tracked_s, self._is_contradicted = stamp_s, False
        self.lay(T_odom_base)

    def lay(self, T_odom_base: FloatArray | None) -> None:
        """Put the map to where the last frame, if it was believed, is where the base was by what is known now."""
        if self._T_map_camera is not None and T_odom_base is not None:
            self._lay(motions.times(T_odom_base, self._T_base_camera), self._T_map_camera)

    def _lay(self, T_odom_camera: FloatArray, T_map_camera: FloatArray) -> None:
        self.T_odom_map = motions.mended(motions.times(T_odom_camera, motions.inverse(T_map_camera)))
        self._T_map_odom = motions.inverse(self.T_odom_map)

    def moved(self, T_new_old: FloatArray) -> None:
        """Loops have moved the map by (4, 4), from the left, where the camera is; in odom nothing moves."""
        T_old_new = motions.inverse(T_new_old)
        self.T_odom_map = motions.mended(motions.times(self.T_odom_map, T_old_new))
        self._T_map_odom = motions.inverse(self.T_odom_map)
        if self.anchor is not None:
            self.anchor = replace(self.anchor, T_map_camera=motions.times(T_new_old, self.anchor.T_map_camera))
        if self._T_map_camera is not None:
            self._T_map_camera = motions.times(T_new_old, self._T_map_camera)
        if self._T_keyframe_map is not None:
            self._T_keyframe_map = motions.times(self._T_keyframe_map, T_old_new)

    def refer(self, seen: Estimate) -> None:
        """Take by which keyframe the camera remembers its pose T_map_camera."""
        if seen.keyframe is not None and seen.T_keyframe_body is not None and seen.T_odom_body is not None:
            self.keyframe = seen.keyframe
            self._T_keyframe_map = motions.times(seen.T_keyframe_body, motions.inverse(seen.T_odom_body))

    def camera_at(self, T_odom_base: FloatArray) -> FloatArray:
        """T_map_camera (4, 4) of a base in odom."""
        T_map_base = motions.times(motions.inverse(self.T_odom_map), T_odom_base)
        return np.asarray(motions.mended(motions.times(T_map_base, self._T_base_camera)))

    def framed(self, answer: FusedEstimate) -> FusedEstimate:
        """The answer, in the map and relative to a keyframe, too."""
        T_keyframe_base = None
        if self._T_keyframe_map is not None and answer.T_odom_body is not None:
            T_keyframe_base = motions.times(self._T_keyframe_map, motions.times(self._T_map_odom, answer.T_odom_body))
        keyframe = None if T_keyframe_base is None else self.keyframe
        return replace(answer, T_map_odom=self._T_map_odom, keyframe=keyframe, T_keyframe_body=T_keyframe_base)


def is_far(motion: MotionEstimate, way_m: float) -> bool:
    """Whether a motion against an anchor goes so far that the next one is due; a turn by a radian counts as 1.5 m."""
    T = motion.T_reference_current
    return T is not None and bool(motions.view_shift_m(T) > way_m)


def blurred(motion: MotionEstimate, twist: FloatArray | None, noise_s: float) -> MotionEstimate:
    """A motion of the camera, at a velocity (6,) of its own, beside wheels whose times are uncertain by so much.

    What it goes in that time is added to its covariance: else stamps that are off look like slip.
    """
    if twist is None or motion.T_reference_current is None or motion.covariance is None or not noise_s:
        return motion
    apart = se3.adjoint(motion.T_reference_current) @ (twist * noise_s)
    return replace(motion, covariance=motion.covariance + np.outer(apart, apart))


def strayed(motion: MotionEstimate, of_frame: FloatArray, walk_per_m: float) -> MotionEstimate:
    """A motion of the camera, of whose view the errors `of_frame` (6, 6) change along the way.

    What bent depth and a shutter do to one view they do to the next one, so between neighbours it does not show;
    against a frame that is farther back it does.
    """
    T = motion.T_reference_current
    if T is None or motion.covariance is None:
        return motion
    walk = of_frame * (walk_per_m * motions.view_shift_m(T))
    return replace(motion, covariance=with_frame_error(motion.covariance, T, walk))
