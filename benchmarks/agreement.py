"""`python -m benchmarks.agreement`: how far a trajectory, the truth's too, lies from where depth images fit each other.

A truth that was itself tracked by a depth camera cannot judge what is as good as it is. Depth can: two frames some time
apart are aligned by Open3D's point-to-plane ICP, begun at the motion between them that a trajectory shows; what remains
is its disagreement with what both frames saw.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence as Many
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks import contenders
from benchmarks.measure import Feed, keep_to, measure
from benchmarks.sequences import Sequence, default_data_folder, find_sequences
from benchmarks.table import Sheet
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import open_recording

_GAPS = (15, 30, 60)
_EVERY = 10
_FARTHEST_M = 3.0
_VOXEL_M = 0.02
_REACH_M = 0.05
# Of a frame's points, those that must find a surface for the two frames to tell anything.
_LEAST_FITTING = 0.3
# Between poses farther apart a trajectory says nothing.
_LONGEST_GAP_S = 0.1


@dataclass(frozen=True, slots=True)
class Agreement:
    """Medians over pairs of frames of what aligning them changed in the motion between them.

    Attributes:
        gap: frames that the two lie apart.
        pairs: how many were compared.
        metres: of the translation.
        radians: of the rotation.
    """

    gap: int
    pairs: int
    metres: float
    radians: float


class DepthPairs:
    """Open3D's alignment of depth images of one recording."""

    def __init__(self, frames: Many[RgbdFrame], camera: PinholeCamera) -> None:
        import open3d

        if camera.has_distortion:
            raise CalibrationError(
                "depth has a lens, which Open3D does not straighten", fix="ask for another recording"
            )
        self._o3d: Any = open3d
        self._frames = frames
        self._intrinsics = self._o3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
        )
        self._cloud = cache(self._made)

    def _made(self, index: int) -> Any:
        """Points of a frame with their normals, one every two centimetres."""
        geometry = self._o3d.geometry
        depth = geometry.Image(np.ascontiguousarray(self._frames[index].depth_m, np.float32))
        cloud = geometry.PointCloud.create_from_depth_image(
            depth, self._intrinsics, depth_scale=1.0, depth_trunc=_FARTHEST_M
        ).voxel_down_sample(_VOXEL_M)
        cloud.estimate_normals(geometry.KDTreeSearchParamHybrid(3 * _VOXEL_M, 30))
        return cloud

    def change(self, first: int, second: int, T_first_second: FloatArray) -> FloatArray | None:
        """What alignment changes in T_first_second, as (4, 4), or None where the two show too little in common."""
        registration = self._o3d.pipelines.registration
        method = registration.TransformationEstimationPointToPlane(registration.TukeyLoss(_VOXEL_M / 2))
        ends = registration.ICPConvergenceCriteria(max_iteration=60)
        found = registration.registration_icp(
            self._cloud(second), self._cloud(first), _REACH_M, T_first_second, method, ends
        )
        if found.fitness < _LEAST_FITTING:
            return None
        return se3.nearest(se3.invert(T_first_second) @ found.transformation)


def agreement(pairs: DepthPairs, frames: Many[RgbdFrame], trajectory: Trajectory, gap: int) -> Agreement:
    """How far a trajectory T_odom_camera is from what depth images `gap` frames apart say."""
    poses = trajectory.at([frame.stamp_s for frame in frames], _LONGEST_GAP_S)
    changes = []
    for first in range(0, len(frames) - gap, _EVERY):
        T_first_second = se3.invert(poses[first]) @ poses[first + gap]
        change = pairs.change(first, first + gap, T_first_second) if np.isfinite(T_first_second).all() else None
        changes += [] if change is None else [change]
    metres = [float(np.linalg.norm(T[:3, 3])) for T in changes]
    radians = [float(so3.angle(T[:3, :3])) for T in changes]
    middle = (float(np.median(metres)), float(np.median(radians))) if changes else (np.nan, np.nan)
    return Agreement(gap, len(changes), *middle)


def agreement_sheet(name: str, found: dict[str, list[Agreement]]) -> Sheet:
    """One row a trajectory, one column a gap."""
    header = ("trajectory", *(f"{gap} frames apart" for gap in _GAPS))
    rows = tuple(
        (who, *(f"{1e3 * of.metres:.1f} mm, {np.degrees(of.radians):.2f}°" for of in figures))
        for who, figures in found.items()
    )
    return Sheet(f"Disagreement with aligned depth: {name}", header, rows)


def _of(sequence: Sequence) -> dict[str, list[Agreement]]:
    recording = open_recording(sequence.path)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    pairs = DepthPairs(frames, recording.calibration.cameras[1])
    trajectories = {} if sequence.truth is None else {"its truth": sequence.truth}
    for contender in track(contenders.ALL, description="track"):
        trajectories[contender.name] = measure(contender.start, recording, Feed.STREAMED)[1]
    return {
        who: [agreement(pairs, frames, trajectory, gap) for gap in _GAPS]
        for who, trajectory in track(list(trajectories.items()), description="align")
    }


def main() -> None:
    """Print the disagreement of the truth and of every contender."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.agreement", description=__doc__)
    parser.add_argument("--recording", default="red_kitchen", help="of those in the data's folder rgbd")
    arguments = parser.parse_args()
    keep_to(2)
    known = {sequence.name: sequence for sequence in find_sequences(default_data_folder())}
    if arguments.recording not in known:
        parser.error(f"--recording {arguments.recording} is none of {', '.join(known)}")
    sequence = known[arguments.recording]
    try:
        Console(width=130).print(agreement_sheet(sequence.name, _of(sequence)).to_rich())
    except CalibrationError as error:
        parser.error(f"{sequence.name}: {error}")


if __name__ == "__main__":
    main()
