"""wheelsight side by side with its peers, over the same frames on the same machine: `python -m benchmarks`.

__main__   the command: measure, judge, print, keep
sequences  the recordings to run over, and what their truth says of an estimate
contenders one small file each, behind a protocol; a new one is listed in its __init__
measure    one contender over one recording, in a process of its own
run        those processes, one after another, and the figures they give
dense      dense tracking alone, on one thread too
mapping    tracking, fusion and prediction together, beside Open3D's dense SLAM
growth     whether a longer way makes that slower or larger; longdrive, a command of its own, drives 20 minutes
flat       a simulated flat: errors of tracking, and of models given true poses (known_poses) against true_surface
bad_input  a command of its own: what trackers make of cameras that fail (bad_drives), and whether they say so
joined     a command of its own: wheels and camera joined, against each alone, with faults; its parts are joined_*
kernels    how long the first mapped frames take, with kernels to be compiled and with kernels kept
wheels     how quick dead reckoning is
link       how quick the serial link is, and what bad lines (bad_lines) do to it
firmware   what the wheel controller takes of its chip, and how fast wheels it counts, simulated
simulation how quick the simulator is, and whether its memory stays flat
places     how quick places are described, named and learned
bags       how fast bags of ROS are read, and how long an hour's takes to open; by itself
startup    how long importing wheelsight and asking for its help take
parts      these by their names, with their tables and targets
targets    what wheelsight must reach, met or missed by how much
machine    on what all this was measured
table      the figures as tables: in the terminal and in docs/benchmarks/peers.md
"""

from __future__ import annotations

import sys
from types import TracebackType

from wheelsight.core.errors import WheelsightError


def tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """One line for an error that its caller can correct, such as a missing recording; else the whole trace."""
    if isinstance(error, WheelsightError):
        print(f"error: {error}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = tell
