"""Maps fed with true poses, so that what they err is their own: ours, and Open3D's truncated signed distance volume."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import FrameSurface, PredictedView
from wheelsight.core.messages import RgbdFrame
from wheelsight.mapping import SurfelMap
from wheelsight.mapping.surfels import Thinning
from wheelsight.vision.dense import DenseSettings
from wheelsight.vision.dense.alignment import Gridder, ReferenceMaker
from wheelsight_sim import SimulatedRecording

VOXEL_M = 0.006
_BLOCK_VOXELS = 16
# To begin with; it makes room for more where they are needed.
_BLOCKS = 8_000
_TRUNCATION_VOXELS = 8.0
_LEAST_WEIGHT = 3.0
_STEPS_PER_M = 5000.0
_TWIST_S = 0.01


def frame_pairs(ideal: SimulatedRecording, noisy: SimulatedRecording) -> Iterator[tuple[RgbdFrame, RgbdFrame]]:
    """Frames of both cameras at the same moments; the rolling shutter's drive ends a little sooner."""
    return zip(ideal.renderer.frames(), noisy.renderer.frames(), strict=False)


class TruePoses:
    """Where a simulated camera is, and how it moves."""

    def __init__(self, recording: SimulatedRecording) -> None:
        self._truth = recording.ground_truth
        T_base_camera = recording.true_calibration.T_base_camera
        assert T_base_camera is not None
        self._T_base_camera = T_base_camera

    def at(self, stamp_s: float) -> FloatArray:
        """T_odom_camera (4, 4)."""
        inside_s = np.clip(stamp_s, *self._truth.stamps_s[[0, -1]])
        return np.asarray(se3.compose(self._truth.at(inside_s)[0], self._T_base_camera))

    def twist(self, stamp_s: float) -> FloatArray:
        """(6,) the camera's velocity (v, ω) in its own frame."""
        return se3.twist_between(self.at(stamp_s - _TWIST_S / 2), self.at(stamp_s + _TWIST_S / 2), _TWIST_S)


class KnownSurfels:
    """A `SurfelMap` that frames are fused into where they were."""

    def __init__(self, calibration: Calibration) -> None:
        settings = DenseSettings()
        self.map = SurfelMap()
        self._thinning = Thinning(self.map.settings)
        self._noise = calibration.depth_noise
        self._gridder = Gridder(calibration, settings)
        self._maker = ReferenceMaker(calibration.depth_noise)

    def fuse(self, frame: RgbdFrame, poses: TruePoses) -> None:
        """Straighten and fuse a frame, after its view was predicted, as a tracker needs it."""
        prepared = self.prepare(frame, poses)
        self.step(prepared, poses.at(frame.stamp_s), frame.stamp_s)

    def prepare(self, frame: RgbdFrame, poses: TruePoses) -> FrameSurface:
        """Depth, normals and grey on the ideal grid."""
        finest = self._gridder.on_grid(frame, poses.twist(frame.stamp_s)).levels[0]
        return FrameSurface(finest.depth_m, self._maker.normals(finest), finest.grey)

    def step(self, prepared: FrameSurface, T_odom_camera: FloatArray, stamp_s: float) -> PredictedView:
        """What a map does for each frame: a view predicted, which is returned, and the frame fused unless alike."""
        intrinsics = self._gridder.intrinsics
        view = self.map.predict(T_odom_camera, intrinsics, self._gridder.shape)
        frames = self._thinning.count(T_odom_camera, stamp_s)
        if frames:
            self.map.fuse(prepared, intrinsics, T_odom_camera, stamp_s, self._noise, frames)
        return view


class KnownVolume:
    """Open3D's `VoxelBlockGrid` on the CPU, as its own reconstruction example integrates frames.

    Raises ImportError where Open3D is not there.
    """

    def __init__(self, calibration: Calibration, far_m: float) -> None:
        import open3d

        self._o3d: Any = open3d
        self._far_m = far_m
        core = self._o3d.core
        self._device: Any = core.Device("CPU:0")
        self._K = core.Tensor(calibration.cameras[1].K)
        kinds = (core.float32, core.float32, core.float32)
        shapes = ((1,), (1,), (3,))
        given = (VOXEL_M, _BLOCK_VOXELS, _BLOCKS, self._device)
        self._grid: Any = self._o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight", "color"), kinds, shapes, *given)

    def fuse(self, frame: RgbdFrame, poses: TruePoses) -> None:
        """Integrate a frame where it was."""
        steps = (frame.depth_m * _STEPS_PER_M).round().astype(np.uint16)
        image = self._o3d.t.geometry.Image
        depth, color = image(self._tensor(steps)), image(self._tensor(frame.color))
        extrinsic = self._tensor(se3.invert(poses.at(frame.stamp_s)))
        limits = (_STEPS_PER_M, self._far_m)
        blocks = self._grid.compute_unique_block_coordinates(depth, self._K, extrinsic, *limits, _TRUNCATION_VOXELS)
        self._grid.integrate(blocks, depth, color, self._K, self._K, extrinsic, *limits, _TRUNCATION_VOXELS)

    def points(self) -> FloatArray:
        """(n, 3) of the surface, where enough frames saw it."""
        cloud = self._grid.extract_point_cloud(weight_threshold=_LEAST_WEIGHT)
        return np.asarray(cloud.point.positions.numpy(), float)

    def _tensor(self, values: Any) -> Any:
        return self._o3d.core.Tensor(np.ascontiguousarray(values), device=self._device)
