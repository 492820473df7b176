"""Open3D's `rgbd_odometry_multi_scale`: hybrid of depth and intensity (Park et al. 2017), from frame to frame."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.contenders.frame_to_frame import FrameToFrame
from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame


class Open3dOdometry(FrameToFrame):
    """The tensor pipeline on the CPU, with the library's own settings."""

    def __init__(self, calibration: Calibration, register: bool = False) -> None:
        import open3d

        super().__init__(calibration, register)
        self._o3d: Any = open3d
        self._device = self._o3d.core.Device("CPU:0")
        self._intrinsics = self._o3d.core.Tensor(self.K)

    def native(self, frame: RgbdFrame) -> Any:
        """An RGBD image on the CPU, depth in metres."""
        return self._o3d.t.geometry.RGBDImage(self._image(frame.color), self._image(frame.depth_m))

    def motion(self, previous: Any, current: Any) -> FloatArray | None:
        """T_previous_current (4, 4), or None where no pixel agrees or the equations are singular."""
        odometry = self._o3d.t.pipelines.odometry
        try:
            result = odometry.rgbd_odometry_multi_scale(
                current, previous, self._intrinsics, depth_scale=1.0, method=odometry.Method.Hybrid
            )
        except RuntimeError:
            return None
        return np.array(result.transformation.numpy()) if result.fitness > 0 else None

    def _image(self, values: Any) -> Any:
        return self._o3d.t.geometry.Image(self._o3d.core.Tensor(np.ascontiguousarray(values), device=self._device))


HYBRID = Contender(
    name="Open3D multi-scale hybrid",
    start=Open3dOdometry,
    settings="`t.pipelines.odometry.rgbd_odometry_multi_scale`, method Hybrid, CPU, frame to frame; default settings "
    "(10, 5, 3 iterations; depth up to 3 m); depth in metres",
    is_peer=True,
)

REGISTERED = Contender(
    name="Open3D multi-scale, depth registered",
    start=partial(Open3dOdometry, register=True),
    settings="the same, given depth that `cv2.registerDepth` brought into the colour camera",
    is_peer=True,
    registers=True,
)
