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
    if estimate.T_map_body is None:
        print(f"{estimate.stamp_s:.3f} s  {estimate.status}: {estimate.reason} {localizer.note}")
        continue
    x, y, z = estimate.T_map_body[:3, 3]
    print(f"{estimate.stamp_s:.3f} s  {estimate.body} at {x:+.3f} {y:+.3f} {z:+.3f} m, {estimate.status}")

for warning in localizer.warnings:
    print(f"warning: {warning}")
