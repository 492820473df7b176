"""Every step by hand: keypoints, points, matches, motion, trajectory, error; frame to frame, as Zhang, section 3.

It shows what the parts are called; `FeatureOdometry` does each step better, and says when it is lost.
Usage: python examples/step_by_step.py RECORDING
"""

import sys

import cv2
import numpy as np

from wheelsight import RgbdFrame, Trajectory, evaluate, open_recording
from wheelsight.errors import DegenerateGeometryError
from wheelsight.geometry import align_points, se3
from wheelsight.recordings import express_for

INLIER_M = 0.03
FEWEST_PAIRS = 20  # of a camera that sees: one that something lies on has none

orb = cv2.ORB_create(1000)
matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
rng = np.random.default_rng(0)


def points_and_descriptors(frame, camera):
    """Points (N, 3) in the camera frame, metres, and BRIEF descriptors (N, 32) of keypoints that have a depth."""
    keypoints, descriptors = orb.detectAndCompute(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), None)
    if descriptors is None:
        return np.empty((0, 3)), np.empty((0, 32), np.uint8)
    px = cv2.KeyPoint.convert(keypoints)
    columns, rows = np.rint(px).astype(int).T
    depth_m = frame.depth_m[rows, columns]
    measured = depth_m > 0
    return camera.back_project(px[measured], depth_m[measured]), descriptors[measured]


def align_most(p_reference, p_current, trials=200):
    """T_reference_current on which most point pairs agree: RANSAC over closed-form alignment."""
    agreeing = np.zeros(len(p_current), bool)
    for _ in range(trials):
        three = rng.choice(len(p_current), 3, replace=False)
        try:
            T_reference_current = align_points(p_reference[three], p_current[three])
        except DegenerateGeometryError:
            continue
        distance_m = np.linalg.norm(se3.apply(T_reference_current, p_current) - p_reference, axis=1)
        if (distance_m < INLIER_M).sum() > agreeing.sum():
            agreeing = distance_m < INLIER_M
    return align_points(p_reference[agreeing], p_current[agreeing])


recording = open_recording(sys.argv[1])
if not recording.calibration.is_registered:
    sys.exit("this example looks depth up at colour pixels, so both must share one pixel grid")

frames = (event for event in recording.events() if isinstance(event, RgbdFrame))
stamps_s, poses, unseen = [], [], 0
p_reference, reference_descriptors = np.empty((0, 3)), np.empty((0, 32), np.uint8)
for frame in frames:
    p_current, descriptors = points_and_descriptors(frame, recording.calibration.depth)
    pairs = matcher.match(reference_descriptors, descriptors)
    if not poses and len(p_current) >= FEWEST_PAIRS:
        T_odom_camera = np.eye(4)
    elif len(pairs) >= FEWEST_PAIRS:
        of_reference, of_current = np.array([(pair.queryIdx, pair.trainIdx) for pair in pairs]).T
        T_odom_camera = poses[-1] @ align_most(p_reference[of_reference], p_current[of_current])
    else:  # the next frame is matched with the last one that showed something
        unseen += 1
        continue
    stamps_s.append(frame.stamp_s)
    poses.append(T_odom_camera)
    p_reference, reference_descriptors = p_current, descriptors

estimate = Trajectory(np.array(stamps_s), np.array(poses))
print(f"{len(estimate)} poses over {estimate.length_m:.3f} m; {unseen} frames show nothing known")
if recording.ground_truth is not None:
    evaluation = evaluate(estimate, express_for("camera", recording.ground_truth, recording.calibration))
    print(f"ATE {evaluation.ate.translation.rmse:.4f} m RMSE")
