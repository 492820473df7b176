"""Open3D's dense SLAM (`t.pipelines.slam`): a truncated signed distance volume, tracked against and ray-cast (CPU)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from benchmarks.contenders.plain_images import PlainImages
from benchmarks.contenders.protocol import Contender
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray
from wheelsight.core.messages import RgbdFrame

# As of Open3D's own example, dense_slam.py.
_DEPTH_MIN_M, _DEPTH_MAX_M = 0.1, 3.0
_ODOMETRY_DISTANCE_M = 0.07
_TRUNCATION_VOXELS = 8.0
_BLOCK_VOXELS = 16
# The library's default; it makes room for more where they are needed.
_BLOCKS = 10_000
# What volumes take beside colour of bytes is depth of 16 bits; 0.2 mm a step spares it Open3D's own millimetre.
_STEPS_PER_M = 5000.0


class Open3dSlam:
    """Each frame is tracked against the model, integrated, and the model's view rendered for the next one."""

    def __init__(self, calibration: Calibration, voxel_m: float) -> None:
        import open3d

        self._o3d: Any = open3d
        self._slam: Any = self._o3d.t.pipelines.slam
        self._device: Any = self._o3d.core.Device("CPU:0")
        self._images = PlainImages(calibration, register=not calibration.is_registered)
        self._T_odom_view = np.eye(4)
        start = self._o3d.core.Tensor(self._T_odom_view)
        self._model: Any = self._slam.Model(voxel_m, _BLOCK_VOXELS, _BLOCKS, start, self._device)
        camera = self._images.camera
        about = (camera.height, camera.width, self._o3d.core.Tensor(camera.K), self._device)
        self._seen, self._predicted = (self._slam.Frame(*about) for _ in range(2))
        self._count = 0

    def prepare(self, frame: RgbdFrame) -> tuple[Any, Any]:
        """Depth and colour as Open3D's images, free of distortion, depth registered."""
        plain = self._images.of(frame)
        steps = (plain.depth_m * _STEPS_PER_M).round().clip(0, np.iinfo(np.uint16).max).astype(np.uint16)
        return self._image(steps), self._image(plain.color)

    def track(self, prepared: tuple[Any, Any]) -> FloatArray | None:
        """T_odom_camera (4, 4), or None where the model does not explain the frame, which then is not integrated."""
        for name, image in zip(("depth", "color"), prepared, strict=True):
            self._seen.set_data_from_image(name, image)
        if self._count and not self._locate():
            return None
        model, scale = self._model, _STEPS_PER_M
        model.update_frame_pose(self._count, self._o3d.core.Tensor(self._T_odom_view))
        model.integrate(self._seen, scale, _DEPTH_MAX_M, _TRUNCATION_VOXELS)
        model.synthesize_model_frame(self._predicted, scale, _DEPTH_MIN_M, _DEPTH_MAX_M, _TRUNCATION_VOXELS, False)
        self._count += 1
        return self._T_odom_view @ self._images.T_view_depth

    def _locate(self) -> bool:
        given = (self._seen, self._predicted, _STEPS_PER_M, _DEPTH_MAX_M, _ODOMETRY_DISTANCE_M)
        try:
            result = self._model.track_frame_to_model(*given)
        except RuntimeError:
            return False
        if result.fitness > 0:
            self._T_odom_view = self._T_odom_view @ result.transformation.numpy()
        return bool(result.fitness > 0)

    def _image(self, values: Any) -> Any:
        return self._o3d.t.geometry.Image(self._o3d.core.Tensor(np.ascontiguousarray(values), device=self._device))


def _contender(voxel_m: float) -> Contender:
    return Contender(
        name=f"Open3D dense SLAM, {1e3 * voxel_m:g} mm",
        start=partial(Open3dSlam, voxel_m=voxel_m),
        settings=f"`t.pipelines.slam` on the CPU, voxels of {1e3 * voxel_m:g} mm, settings of its own example "
        f"(depth up to {_DEPTH_MAX_M:g} m, truncation at {_TRUNCATION_VOXELS:g} voxels), {_BLOCKS:,} blocks to begin "
        "with; registered depth; a frame is tracked, integrated, and the next view rendered",
        is_peer=True,
    )


FINE, COARSE = _contender(0.006), _contender(0.020)
