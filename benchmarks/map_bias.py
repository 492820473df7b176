"""`python -m benchmarks.map_bias`: whether surfaces of a map lie too near or too far, though it is fed with true poses.

Noise is averaged out; the rest moves a camera that is tracked in the map a little with each frame. The tables have the
mean depth of frames and of the map from the true pose, less the true depth, by the distance of the surface. Pixels
whose neighbours are of another surface, by the true depth, do not count.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console

from benchmarks.known_poses import KnownSurfels, TruePoses, frame_pairs
from benchmarks.table import Sheet
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight_sim import SimulatedRecording, SimulationSettings, simulate, world_names

EDGES_M = np.array([1.0, 2.0, 3.0, 4.0, 4.5, 5.0, 5.5, 6.0])
# Deviations of a curve of 1/z from a line, which is what a plane makes, beyond which pixels span an edge.
_BENT_PER_M = 1e-3
# What is farther off than this is another surface, or none.
_SAME_M = 0.4
# Frames until the map has something to show.
_FIRST = 10


@dataclass(eq=False)
class Bias:
    """Sums over pixels, by distance: how many were asked, and of frame and map how many answered, and the error.

    Attributes:
        asked: (n,). answered: (2, n). off_m: (2, n).
    """

    asked: FloatArray = field(default_factory=lambda: np.zeros(len(EDGES_M) - 1))
    answered: FloatArray = field(default_factory=lambda: np.zeros((2, len(EDGES_M) - 1)))
    off_m: FloatArray = field(default_factory=lambda: np.zeros((2, len(EDGES_M) - 1)))

    def add(self, true_m: FloatArray, seen: tuple[FloatArray, FloatArray], asked: BoolArray) -> None:
        """Count the pixels `asked` of true depth (h, w), and of the frame's and the map's (0 where there is none)."""
        self.asked += np.histogram(true_m[asked], EDGES_M)[0]
        for k, depth_m in enumerate(seen):
            known = asked & (depth_m > 0) & (np.abs(depth_m - true_m) < _SAME_M)
            self.answered[k] += np.histogram(true_m[known], EDGES_M)[0]
            self.off_m[k] += np.histogram(true_m[known], EDGES_M, weights=(depth_m - true_m)[known])[0]

    @property
    def mean_m(self) -> FloatArray:
        """(2, n) of frame and map, NaN where nothing answered."""
        return np.where(self.answered > 0, self.off_m / np.maximum(self.answered, 1), np.nan)


def measure_bias(ideal: SimulatedRecording, noisy: SimulatedRecording) -> tuple[Bias, Bias]:
    """Of the floor, and of all else, along a drive that an ideal camera and a real one see."""
    poses, surfels = TruePoses(noisy), KnownSurfels(noisy.calibration)
    rays, floor, rest = ideal.calibration.cameras[1].rays(), Bias(), Bias()
    for k, (exact, frame) in enumerate(frame_pairs(ideal, noisy)):
        T_odom_camera, prepared = poses.at(frame.stamp_s), surfels.prepare(frame, poses)
        view = surfels.step(prepared, T_odom_camera, frame.stamp_s)
        if k < _FIRST:
            continue
        true_m = exact.depth_m.astype(float)
        height_m = (true_m[..., None] * rays) @ T_odom_camera[2, :3] + T_odom_camera[2, 3]
        is_floor, seen = np.abs(height_m) < 1e-2, (prepared.depth_m.astype(float), view.depth_m.astype(float))
        floor.add(true_m, seen, _on_planes(true_m) & is_floor)
        rest.add(true_m, seen, _on_planes(true_m) & ~is_floor)
    return floor, rest


def bias_sheet(name: str, bias: Bias) -> Sheet:
    """A row a distance."""
    rows = tuple(
        (f"{EDGES_M[k]:g} to {EDGES_M[k + 1]:g} m", *(_cell(bias, source, k) for source in (0, 1)))
        for k in range(len(bias.asked))
        if bias.asked[k] > 0
    )
    return Sheet(f"{name}: depth less the true one, mm (share of pixels that have one)", ("", "frame", "map"), rows)


def _cell(bias: Bias, source: int, k: int) -> str:
    return f"{1e3 * bias.mean_m[source, k]:.1f} ({100 * bias.answered[source, k] / bias.asked[k]:.0f} %)"


def _on_planes(true_m: FloatArray) -> BoolArray:
    """(h, w) whether a pixel and those three beside it on each side lie on one plane."""
    near = 1 / np.where(true_m > 0, true_m, np.nan)
    is_flat = np.zeros(true_m.shape, bool)
    across = np.abs(near[3:-3, :-6] + near[3:-3, 6:] - 2 * near[3:-3, 3:-3])
    down = np.abs(near[:-6, 3:-3] + near[6:, 3:-3] - 2 * near[3:-3, 3:-3])
    is_flat[3:-3, 3:-3] = (across < _BENT_PER_M) & (down < _BENT_PER_M)
    return is_flat


def drives(world: str, seconds: float, size: tuple[int, int] = (320, 240)) -> list[SimulatedRecording]:
    """One drive, seen by an ideal camera and by a Kinect, at 10 images a second."""
    return [
        simulate(SimulationSettings(world, camera=camera, size=size, rate_hz=10.0, duration_s=seconds, seed=1))
        for camera in ("ideal", "kinect-v1")
    ]


def main() -> None:
    """Drive, and print tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.map_bias", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--world", default="floor4", choices=world_names())
    parser.add_argument("--seconds", type=float, default=45.0)
    arguments = parser.parse_args()
    floor, rest = measure_bias(*drives(arguments.world, arguments.seconds))
    for name, bias in (("Floor", floor), ("Walls and all else", rest)):
        Console(width=100).print(bias_sheet(name, bias).to_rich())


if __name__ == "__main__":
    main()
