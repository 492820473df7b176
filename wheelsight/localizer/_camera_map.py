"""CameraMap: the frame in which camera odometry has its poses, and where it lies in odom.

What the filter knows better moves the pose but no surfel, which would tear the map: so the map as a whole is moved to
where the camera's last believed pose in it is the one that is known of its frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.estimates import Estimate
from wheelsight.fusion import FusedEstimate
from wheelsight.geometry import FloatArray
from wheelsight.geometry import motion_kernels as motions
from wheelsight.keyframes import KeyframeId
from wheelsight.localizer._anchor import Anchor


class CameraMap:
    """See the module.

    Attributes:
        T_odom_map: (4, 4) where the map, of the camera and its surfels, lies by now.
        anchor: the frame against which the camera's motions are told to the filter; None before the camera begins.
        seen_s: stamp of the last frame that was believed.
    """

    def __init__(self, T_base_camera: FloatArray) -> None:
        self.T_odom_map: FloatArray = np.eye(4)
        self.anchor: Anchor | None = None
        self.seen_s = -np.inf
        self._T_base_camera = T_base_camera
        self._T_map_odom: FloatArray = np.eye(4)
        self._T_map_camera: FloatArray | None = None  # at the last frame, where that was believed
        self._keyframe: KeyframeId | None = None
        self._T_keyframe_map: FloatArray | None = None

    def forget_frame(self) -> None:
        """The last frame is over."""
        self._T_map_camera = None

    def believe(self, stamp_s: float, T_map_camera: FloatArray, T_odom_base: FloatArray | None) -> None:
        """A frame is where the camera has it in the map, and the base was at a pose when its image was taken."""
        self._T_map_camera, self.seen_s = T_map_camera, stamp_s
        self.lay(T_odom_base)

    def lay(self, T_odom_base: FloatArray | None) -> None:
        """Put the map to where the last frame, if it was believed, is where the base was by what is known now."""
        if self._T_map_camera is not None and T_odom_base is not None:
            T_odom_camera = motions.times(T_odom_base, self._T_base_camera)
            self.T_odom_map = motions.mended(motions.times(T_odom_camera, motions.inverse(self._T_map_camera)))
            self._T_map_odom = motions.inverse(self.T_odom_map)

    def refer(self, seen: Estimate) -> None:
        """Take by which keyframe the camera remembers its pose T_map_camera."""
        if seen.keyframe is not None and seen.T_keyframe_body is not None and seen.T_odom_body is not None:
            self._keyframe = seen.keyframe
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
        keyframe = None if T_keyframe_base is None else self._keyframe
        return replace(answer, T_map_odom=self._T_map_odom, keyframe=keyframe, T_keyframe_body=T_keyframe_base)
