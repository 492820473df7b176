"""Every step by hand: keypoints, points, matches, motion, trajectory, error; frame to frame, as Zhang, section 3.

It shows what the parts are called; `FeatureOdometry` does each step better, and says when it is lost.
Usage: python examples/step_by_step.py RECORDING
"""

import sys

import cv2
import numpy as np

from wheelsight import RgbdFrame, Trajectory, evaluate, open_recording
from wheelsight.core.geometry import align_points, se3
from wheelsight.io.recordings import express_for

INLIER_M = 0.03
FEWEST_PAIRS = 20  # fewer determine no motion: something lies on the camera

orb = cv2.ORB_create(1000)
matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)


def keypoints_of(frame, camera):
    """Points (N, 3) in the camera frame, metres, and BRIEF descriptors (N, 32) of keypoints that have a depth."""
    keypoints, descriptors = orb.detectAndCompute(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), None)
    if descriptors is None:
        return np.empty((0, 3)), np.empty((0, 32), np.uint8)
    px = cv2.KeyPoint.convert(keypoints)
    columns, rows = np.rint(px).astype(int).T
    depth_m = frame.depth_m[rows, columns]
    has_depth = depth_m > 0
    return camera.back_project(px[has_depth], depth_m[has_depth]), descriptors[has_depth]


def motion_between(reference, current):
    """T_reference_current on which most matches agree, or None; closed form, pairs far apart count for less."""
    (p_reference, descriptors_reference), (p_current, descriptors_current) = reference, current
    pairs = matcher.match(descriptors_reference, descriptors_current)
    if len(pairs) < FEWEST_PAIRS:
        return None
    i, j = np.array([(pair.queryIdx, pair.trainIdx) for pair in pairs]).T
    p_reference, p_current = p_reference[i], p_current[j]
    T_reference_current = np.eye(4)
    for scale_m in np.geomspace(0.5, INLIER_M, 20):
        distance_m = np.linalg.norm(se3.apply(T_reference_current, p_current) - p_reference, axis=1)
        T_reference_current = align_points(p_reference, p_current, 1 / (1 + (distance_m / scale_m) ** 2) ** 2)
    return T_reference_current


recording = open_recording(sys.argv[1])
if not recording.calibration.is_registered:
    sys.exit("this example looks depth up at colour pixels, so both must share one pixel grid")

stamps_s, poses, reference = [], [], None
for frame in filter(lambda event: isinstance(event, RgbdFrame), recording.events()):
    current = keypoints_of(frame, recording.calibration.depth)
    if len(current[0]) < FEWEST_PAIRS:
        continue
    T_reference_current = np.eye(4) if reference is None else motion_between(reference, current)
    if T_reference_current is None:  # the next frame is matched with the last one that showed something
        continue
    T_map_reference = poses[-1] if poses else np.eye(4)
    poses.append(T_map_reference @ T_reference_current)
    stamps_s.append(frame.stamp_s)
    reference = current

estimate = Trajectory(np.array(stamps_s), np.array(poses))
print(f"{len(estimate)} poses over {estimate.length_m:.3f} m")
if recording.ground_truth is not None:
    evaluation = evaluate(estimate, express_for("camera", recording.ground_truth, recording.calibration))
    print(f"ATE {evaluation.ate.translation.rmse:.4f} m RMSE")
