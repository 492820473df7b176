"""Compiles all kernels before the tests of a fresh clone, in two processes: else all workers compile most of them.

python tests/warm_up.py
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from wheelsight.app.run.kernels import compile_kernels, missing_parts, usable_parts

# The parts of a run share kernels, and go one after the other; the others share none with them.
OF_RUNS = ("wheels", "dense", "joined", "loops", "features")


def main() -> None:
    missing = missing_parts(usable_parts())
    groups = [
        [part for part in OF_RUNS if part in missing],
        [part for part in missing if part not in OF_RUNS],
    ]
    with ThreadPoolExecutor(len(groups)) as pool:
        list(pool.map(compile_kernels, groups))


if __name__ == "__main__":
    main()
