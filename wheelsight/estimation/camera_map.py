"""CameraMap: the map frame of camera odometry, and its pose in odom.

Corrections of the filter move the pose but no single surfel, which would tear the map apart. Instead the whole map
moves, so that the camera's last accepted pose in it is the filter's pose of that frame.
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
    """Reference frame of the camera's motions in the filter.

    Attributes:
        T_map_camera: (4, 4) its pose by odometry.
        covariance: (6, 6) of its alignment, in its own frame. All motions against it share this error.
    """

    T_map_camera: FloatArray
    covariance: FloatArray

    @classmethod
    def at(cls, T_map_camera: FloatArray, motion: MotionEstimate) -> Anchor:
        """Return the anchor of a frame at a pose that was aligned by `motion`."""
        assert motion.T_reference_current is not None
        assert motion.covariance is not None
        return cls(T_map_camera, motions.carried(motions.inverse(motion.T_reference_current), motion.covariance))

    def motion_to(self, T_map_camera: FloatArray, motion: MotionEstimate) -> MotionEstimate:
        """Return the motion from here to a pose that was aligned by `motion` against another reference.

        Its covariance and its degenerate directions are those of that alignment.
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


# Distance between the filter's pose and the camera's in its map, metres, from which on the camera has left its map. A
# turn by a radian counts as 1.5 m. The wheels err by less in the second or two of a contradiction.
_LEFT_MAP_M = 0.15
# After a longer gap without frames, seconds, the camera may be right, and the wheels may have drifted.
_LONGEST_GAP_S = 0.5


class CameraMap:
    """Pose of the camera's map in odom; see the module.

    Attributes:
        T_odom_map: (4, 4) current pose of the map of camera and surfels.
        anchor: reference frame of the camera's motions in the filter; None before the camera starts.
        seen_s: stamp of the last accepted frame.
        keyframe: by which that frame was tracked.

    Args:
        T_base_camera: (4, 4).
        T_map_camera: (4, 4) initial pose of the camera, with the base at the origin of odom; None if the map starts
            there.
    """

    def __init__(self, T_base_camera: FloatArray, T_map_camera: FloatArray | None = None) -> None:
        self.T_odom_map: FloatArray = np.eye(4)
        self.anchor: Anchor | None = None
        self.seen_s = -np.inf
        self._T_base_camera = T_base_camera
        self._T_map_odom: FloatArray = np.eye(4)
        if T_map_camera is not None:
            self._lay(T_base_camera, T_map_camera)
        self._T_map_camera: FloatArray | None = None  # of the last frame, if it was accepted
        self.keyframe: KeyframeId | None = None
        self._T_keyframe_map: FloatArray | None = None
        self._tracked_s, self._is_contradicted = -np.inf, False

    def forget_frame(self) -> None:
        """Forget the pose of the last frame."""
        self._T_map_camera = None

    def track(self, stamp_s: float, *, is_believed: bool) -> None:
        """Note that a frame was tracked, and whether the filter accepted it."""
        if not is_believed and stamp_s - self._tracked_s <= _LONGEST_GAP_S:
            self._is_contradicted = True
        self._tracked_s = stamp_s

    def is_left(self, T_map_camera: FloatArray, T_odom_base: FloatArray | None) -> bool:
        """Whether a camera at a pose (4, 4) has left the map, by the filter's pose of the base.

        If the filter rejected consecutive frames and accepts the next ones, the camera has jumped, for instance by the
        period of a repeating pattern. Aligning the map with the camera's pose would make the map jump as well.
        """
        if not self._is_contradicted or T_odom_base is None:
            return False
        T_odom_camera = motions.times(T_odom_base, self._T_base_camera)
        by_map = motions.times(self.T_odom_map, T_map_camera)
        return bool(motions.view_shift_m(motions.times(motions.inverse(by_map), T_odom_camera)) > _LEFT_MAP_M)

    def accept(self, stamp_s: float, T_map_camera: FloatArray, T_odom_base: FloatArray | None) -> None:
        """Accept the camera's pose of a frame in the map; `T_odom_base` is the base's pose when its image was taken."""
        self._T_map_camera, self.seen_s = T_map_camera, stamp_s
        self._tracked_s, self._is_contradicted = stamp_s, False
        self.lay(T_odom_base)

    def lay(self, T_odom_base: FloatArray | None) -> None:
        """Align the map so that the last frame, if it was accepted, is at the filter's current estimate of its pose."""
        if self._T_map_camera is not None and T_odom_base is not None:
            self._lay(motions.times(T_odom_base, self._T_base_camera), self._T_map_camera)

    def _lay(self, T_odom_camera: FloatArray, T_map_camera: FloatArray) -> None:
        self.T_odom_map = motions.mended(motions.times(T_odom_camera, motions.inverse(T_map_camera)))
        self._T_map_odom = motions.inverse(self.T_odom_map)

    def moved(self, T_new_old: FloatArray) -> None:
        """Apply a correction (4, 4) of the map by loops, from the left, at the camera. In odom nothing moves."""
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
        """Set the keyframe by which the camera was tracked."""
        if seen.keyframe is not None and seen.T_keyframe_body is not None and seen.T_odom_body is not None:
            self.keyframe = seen.keyframe
            self._T_keyframe_map = motions.times(seen.T_keyframe_body, motions.inverse(seen.T_odom_body))

    def camera_at(self, T_odom_base: FloatArray) -> FloatArray:
        """Return T_map_camera (4, 4) for a pose of the base in odom."""
        T_map_base = motions.times(motions.inverse(self.T_odom_map), T_odom_base)
        return np.asarray(motions.mended(motions.times(T_map_base, self._T_base_camera)))

    def framed(self, answer: FusedEstimate) -> FusedEstimate:
        """Return the estimate with its poses in the map and relative to a keyframe."""
        T_keyframe_base = None
        if self._T_keyframe_map is not None and answer.T_odom_body is not None:
            T_keyframe_base = motions.times(self._T_keyframe_map, motions.times(self._T_map_odom, answer.T_odom_body))
        keyframe = None if T_keyframe_base is None else self.keyframe
        return replace(answer, T_map_odom=self._T_map_odom, keyframe=keyframe, T_keyframe_body=T_keyframe_base)


def is_far(motion: MotionEstimate, way_m: float) -> bool:
    """Whether a motion exceeds the distance to a new anchor; a turn by a radian counts as 1.5 m."""
    T = motion.T_reference_current
    return T is not None and bool(motions.view_shift_m(T) > way_m)


def blurred(motion: MotionEstimate, twist: FloatArray | None, noise_s: float) -> MotionEstimate:
    """Return a motion of the camera with a covariance for the time error of wheel readings, at a velocity (6,).

    Otherwise wrong stamps would look like slip.
    """
    if twist is None or motion.T_reference_current is None or motion.covariance is None or not noise_s:
        return motion
    apart = se3.adjoint(motion.T_reference_current) @ (twist * noise_s)
    return replace(motion, covariance=motion.covariance + np.outer(apart, apart))


def strayed(motion: MotionEstimate, of_frame: FloatArray, walk_per_m: float) -> MotionEstimate:
    """Return a motion of the camera with a covariance for systematic errors `of_frame` (6, 6) that vary with the view.

    Distorted depth and a rolling shutter affect neighbouring views alike, so that their relative motion is exact. The
    errors show against a frame that is farther away.
    """
    T = motion.T_reference_current
    if T is None or motion.covariance is None:
        return motion
    walk = of_frame * (walk_per_m * motions.view_shift_m(T))
    return replace(motion, covariance=with_frame_error(motion.covariance, T, walk))
