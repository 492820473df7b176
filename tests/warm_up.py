"""Compiles all kernels before the tests of a fresh clone, in two processes: else all workers compile most of them.

python tests/warm_up.py
"""

from __future__ import annotations

import subprocess
import sys

from wheelsight.app.run.kernels import missing_parts, usable_parts

# The parts of a run share kernels, and go one after the other; the others share none with them.
OF_RUNS = ("wheels", "dense", "joined", "loops", "features")


def main() -> None:
    missing = missing_parts(usable_parts())
    groups = [
        [part for part in OF_RUNS if part in missing],
        [part for part in missing if part not in OF_RUNS],
    ]
    # One process for each group, not for each part as before a run: memory is no matter here, and each costs seconds.
    command = [sys.executable, "-m", "wheelsight.app.run.kernel_process"]
    processes = [subprocess.Popen([*command, *group], stdout=subprocess.DEVNULL) for group in groups if group]
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SystemExit("kernels could not be compiled")


if __name__ == "__main__":
    main()
