"""All in one: a recording becomes a folder with trajectory, status, metrics and report.

Usage: python examples/all_in_one.py RECORDING OUT
"""

import sys
from pathlib import Path

from wheelsight import Config, open_recording, run

recording, out = sys.argv[1:]
record = run(open_recording(recording), Config(), Path(out))

print(f"{record.posed} of {len(record.frames)} frames have a pose, over {record.estimate.length_m:.2f} m")
if record.evaluation is not None:
    print(f"ATE {record.evaluation.ate.translation.rmse:.4f} m RMSE")
