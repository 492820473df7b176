"""What a recording shows its own camera, without ground truth: keypoint noise by pyramid level, and the shutter.

    python -m benchmarks.sensor RECORDING

The shutter: frame pairs are aligned with rows straightened for one readout time after another; the time under which
matched points agree best is the camera's. It needs quick turns; a slow recording gives a flat curve.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import FloatArray, IntArray, se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.vision.features import FeatureOdometry, FeatureSettings
from wheelsight.vision.features.tracking import (
    INLIER_CHI2,
    PYRAMID_SCALE,
    FeatureExtractor,
    Features,
    PointPairs,
    find_motion,
    keypoint_sigma_px,
    match_all,
    refine_motion,
    straighten,
)

SHUTTERS_S = (0.0, 0.005, 0.010, 0.015, 0.018, 0.021, 0.024, 0.027, 0.030, 0.035)
GAP = 3
EVERY = 6


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    recording = open_recording(parser.parse_args().recording)
    views, velocities = _walk(recording)
    calibration = recording.calibration
    costs = [_disagreement(views, velocities, calibration, s) for s in track(SHUTTERS_S, "aligning pairs")]
    console = Console()
    console.print(_shutter_table(costs))
    console.print(_noise_table(views, velocities, calibration))


def _walk(recording: Recording) -> tuple[list[Features], list[FloatArray]]:
    """Raw features of all tracked frames but the first and last, and the colour camera's velocity (6,) at each."""
    calibration, settings = recording.calibration, FeatureSettings()
    odometry, extractor = FeatureOdometry(calibration, settings), FeatureExtractor(calibration, settings)
    T_color_camera = np.eye(4) if calibration.T_color_depth is None else np.array(calibration.T_color_depth)
    features, poses = [], []
    for event in track(recording.events(), "tracking", total=recording.frame_count):
        if isinstance(event, RgbdFrame) and (T := odometry.process(event).T_odom_body) is not None:
            features.append(extractor.extract(event))
            poses.append(T @ se3.invert(T_color_camera))
    inner = range(1, len(poses) - 1)
    # The mean over both neighbours is the velocity at the frame itself, to second order.
    seconds = [features[i + 1].stamp_s - features[i - 1].stamp_s for i in inner]
    twists = [se3.twist_between(poses[i - 1], poses[i + 1], s) for i, s in zip(inner, seconds, strict=True)]
    return features[1:-1], twists


def _pairs(before: Features, now: Features, calibration: Calibration) -> tuple[PointPairs, IntArray]:
    """Matched points (N,) with depth in both frames, and the pyramid level (N,) of the later keypoint."""
    matches = match_all(before.descriptors, now.descriptors, max_hamming=50)
    both = before.has_depth[matches.first] & now.has_depth[matches.second]
    i, j = matches.first[both], matches.second[both]
    sigma_xy = np.hypot(before.sigma_px[i], now.sigma_px[j]) / calibration.cameras[0].fx
    sigma_m = np.hypot(before.sigma_m[i], now.sigma_m[j])
    return PointPairs(before.points[i], now.xy[j], now.depth_m[j], sigma_xy, sigma_m), now.level[j]


def _aligned(pairs: PointPairs) -> FloatArray | None:
    T = find_motion(pairs, seed=0)
    return None if isinstance(T, Reason) else refine_motion(pairs, T).T_current_reference


def _chi_square(pairs: PointPairs, T: FloatArray) -> FloatArray:
    p = se3.apply(T, pairs.p_reference)
    in_image = ((p[:, :2] / p[:, 2:] - pairs.xy) / pairs.sigma_xy[:, None]) ** 2
    return np.asarray(in_image.sum(axis=1) + ((p[:, 2] - pairs.depth_m) / pairs.sigma_m) ** 2)


def _disagreement(
    views: list[Features], velocities: list[FloatArray], calibration: Calibration, shutter_s: float
) -> float:
    """Mean χ² of matched points, cut off at the gate, over frames `GAP` apart."""
    costs, height = [], calibration.cameras[0].height
    for i in range(0, len(views) - GAP, EVERY):
        before, now = (straighten(views[k], velocities[k], shutter_s, height) for k in (i, i + GAP))
        pairs, _ = _pairs(before, now, calibration)
        if (T := _aligned(pairs)) is not None:
            costs.append(np.minimum(_chi_square(pairs, T), INLIER_CHI2).mean())
    return float(np.mean(costs))


def _shutter_table(costs: list[float]) -> Table:
    table = Table(title="How well matched points agree")
    table.add_column("rolling_shutter_s", justify="right")
    table.add_column("mean χ²", justify="right")
    for shutter_s, cost in zip(SHUTTERS_S, costs, strict=True):
        table.add_row(f"{shutter_s:.3f}", f"{cost:.4f}" + (" ← best" if cost == min(costs) else ""))
    return table


def _noise_table(views: list[Features], velocities: list[FloatArray], calibration: Calibration) -> Table:
    """Spread of what is left between frames next to each other, over √2 since both were measured."""
    left: dict[int, list[FloatArray]] = {}
    color, shutter_s = calibration.cameras[0], calibration.rolling_shutter_s
    height = color.height
    for i in range(0, len(views) - 1, EVERY):
        before, now = (straighten(views[k], velocities[k], shutter_s, height) for k in (i, i + 1))
        pairs, levels = _pairs(before, now, calibration)
        if (T := _aligned(pairs)) is None:
            continue
        p = se3.apply(T, pairs.p_reference)
        off_px = (p[:, :2] / p[:, 2:] - pairs.xy) * (color.fx, color.fy)
        for level in range(levels.max() + 1):
            left.setdefault(level, []).append(off_px[levels == level].ravel())
    table = Table(title="Noise of a keypoint, px")
    for name in ("level", "pixels of the level", "measured σ", "assumed σ"):
        table.add_column(name, justify="right")
    for level, parts in sorted(left.items()):
        stated = keypoint_sigma_px(level)
        sigma = 1.4826 * np.median(np.abs(np.concatenate(parts))) / np.sqrt(2)
        table.add_row(str(level), f"{PYRAMID_SCALE**level:.2f}", f"{sigma:.2f}", f"{stated:.2f}")
    return table


if __name__ == "__main__":
    main()
