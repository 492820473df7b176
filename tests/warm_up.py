"""Compiles all kernels before the tests of a fresh clone, in three processes: else all workers compile most of them.

python tests/warm_up.py
"""

from __future__ import annotations

import subprocess
import sys

from wheelsight.app.run.kernels import missing_parts, usable_parts

# The parts of a group share kernels, and go one after the other. Of kernels that two groups need, one process compiles
# each, and the other waits for it.
GROUPS = (("dense", "loops", "joined"), ("features", "wheels"))


def main() -> None:
    missing = missing_parts(usable_parts())
    groups = [[part for part in group if part in missing] for group in GROUPS]
    groups.append([part for part in missing if not any(part in group for group in GROUPS)])
    # One process for each group, not for each part as before a run: memory is no matter here, and each costs seconds.
    command = [sys.executable, "-m", "wheelsight.app.run.kernel_process"]
    processes = [subprocess.Popen([*command, *group], stdout=subprocess.DEVNULL) for group in groups if group]
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SystemExit("kernels could not be compiled")


if __name__ == "__main__":
    main()
