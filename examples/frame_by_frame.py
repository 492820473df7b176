"""Prepared: a localizer answers each frame as it comes, as a robot would use it.

Usage: python examples/frame_by_frame.py RECORDING
"""

import sys

import numpy as np

from wheelsight import Localizer, open_recording

recording = open_recording(sys.argv[1])
localizer = Localizer(recording.calibration)

for event in recording.events():
    estimate = localizer.process(event)
    if estimate is None:  # not a frame: wheels turned
        continue
    if estimate.T_odom_body is None:
        print(f"{estimate.stamp_s:.3f} s  {estimate.status}: {estimate.reason} {localizer.note}")
        continue
    x, y, z = estimate.T_odom_body[:3, 3]
    sigma_mm = 0.0 if estimate.covariance is None else 1e3 * np.sqrt(np.trace(estimate.covariance[:3, :3]))
    print(f"{estimate.stamp_s:.3f} s  {estimate.body} at {x:+.3f} {y:+.3f} {z:+.3f} m, σ {sigma_mm:.1f} mm")
