"""Prepared: a localizer answers each event as it comes, as a robot would use it.

Usage: python examples/frame_by_frame.py RECORDING
"""

import sys

from wheelsight import Localizer, open_recording

recording = open_recording(sys.argv[1])
localizer = Localizer(recording.calibration)

for event in recording.events():
    estimate = localizer.process(event)
    if estimate is None:  # not answered: a gyroscope's reading, or a sensor that `localizer.warnings` names
        continue
    if estimate.T_filter_body is None:
        print(f"{estimate.stamp_s:.3f} s  {estimate.status}: {estimate.reason} {localizer.note}")
        continue
    # As in trajectory.txt. T_odom_body has no jumps, as odom.txt; T_map_body is the place in a map or among loops.
    x, y, z = estimate.T_filter_body[:3, 3]
    print(f"{estimate.stamp_s:.3f} s  {estimate.body} at {x:+.3f} {y:+.3f} {z:+.3f} m, {estimate.status}")

for warning in localizer.warnings:
    print(f"warning: {warning}")
