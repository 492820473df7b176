"""Kernels compiled before they are needed, in a process of their own, so that it can be watched and broken off.

Numba compiles a kernel when it is first called, and keeps it on the disk. A small drive in which everything happens is
run there (`rehearsal`), so that later runs find all of it compiled. Compiling takes half a gigabyte, too, which is
free again when the process ends. How long it takes is measured, and remembered beside the kernels.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from wheelsight.config import Config
from wheelsight.errors import OutputError
from wheelsight.files import write_text
from wheelsight.slam.settings import FROM_KEYFRAMES

PACKAGE = Path(__file__).parent.parent
# What each part of wheelsight runs for the sake of its kernels: settings of a run, by their names. What a part calls
# besides runs is in `_compile`.
PARTS: dict[str, tuple[dict[str, Any], ...]] = {
    "wheels": ({"odometry": "wheels"},),
    "features": ({"odometry": "features"}, {"odometry": "features", "features.reference": "previous"}),
    "dense": ({"odometry": "dense"}, {"odometry": "dense", "map": "surfels"}),
    "joined": (
        {"odometry": "wheels,dense", "map": "surfels"},
        {"odometry": "wheels,features"},
        {"odometry": "wheels,dense", "fusion": "ligocki"},
    ),
    "loops": ({"odometry": "dense", "map": "surfels", "loops.source": FROM_KEYFRAMES, "loops.seen.apart_s": 0.0},),
    "places": (),
    "navigation": (),
    "simulation": (),
    "mesh": (),
}
# Libraries without which a part cannot be run at all.
_NEEDS = {"simulation": "mujoco", "mesh": "skimage"}


class PartCost(NamedTuple):
    """What compiling a part takes, once the parts before it are compiled."""

    kernels: int
    seconds: float


# Seconds of one processor (AMD EPYC, 2026-11-28) with nothing beside it. A computer that has compiled a part remembers
# how long it took there.
COSTS = {
    "wheels": PartCost(6, 15),
    "features": PartCost(6, 20),
    "dense": PartCost(39, 62),
    "joined": PartCost(17, 51),
    "loops": PartCost(3, 10),
    "places": PartCost(8, 7),
    "navigation": PartCost(35, 35),
    "simulation": PartCost(24, 37),
    "mesh": PartCost(1, 5),
}
_KERNEL_FILES = ("*_kernels.py", "compiled.py", "geometry/arrays.py")
_MARK = "wheelsight-{}.compiled.json"
_TIMES = "wheelsight-compile-times.json"
# A part of fewer kernels than this share of what it should have was half compiled before: its time says little.
_WHOLE_SHARE = 0.9
# Work, in seconds, for which the first estimate counts: the first kernels say little about the others.
_PRIOR_S = 8.0
_LONGEST_S = 86_400.0  # that a part took; more is a damaged file


def usable_parts() -> tuple[str, ...]:
    """All parts but those whose libraries, which an extra brings, are not installed."""
    return tuple(part for part in PARTS if part not in _NEEDS or find_spec(_NEEDS[part]) is not None)


def parts_of(config: Config) -> tuple[str, ...]:
    """The parts whose kernels a run needs."""
    config = config if config.odometry else config.with_odometry(("wheels", "dense"))  # whatever it may come to
    wanted = {{"rectified": "places"}.get(track, track) for track in config.tracks}
    wanted |= {"places"} if config.places.model is not None else set()
    wanted |= {"loops"} if config.loops.source == FROM_KEYFRAMES else set()
    wanted |= (
        {"dense"} if config.sessions.keep_map else set()
    )  # keyframes are halved and recognised as dense odometry's
    return tuple(part for part in PARTS if part in wanted)


def missing_parts(parts: Sequence[str]) -> tuple[str, ...]:
    """Those of the parts that were not compiled yet, or whose kernels have changed or gone since."""
    if not _are_kernels():
        return ()
    return tuple(part for part in parts if not _is_compiled(part))


def compile_kernels(parts: Sequence[str], on_kernel: Callable[[str, int], None] = lambda part, kernels: None) -> None:
    """Compile what the parts need, each in a process of its own; Ctrl-C ends that at once.

    The compiler keeps what it has made: in one process for all parts its memory would grow with each.

    Args:
        parts: of PARTS.
        on_kernel: called with the part and how many kernels were compiled so far, after each.

    Raises:
        OutputError: it cannot be done; says why.
    """
    before = 0
    for part in parts:
        made, began_s = 0, time.monotonic()
        with closing(_compile(part)) as compiling:  # an exception in on_kernel ends the process, too
            for made in compiling:
                on_kernel(part, before + made)
        before += made
        _remember(part, PartCost(made, time.monotonic() - began_s))


class CompileEstimate:
    """How long compiling takes on this computer: by what it took here before, and by the rate at which it goes.

    Attributes:
        total_s: the first estimate, of all parts.
        is_measured: whether that is this computer's own, rather than another's.
    """

    def __init__(self, parts: Sequence[str]) -> None:
        known = remembered_costs()
        ours, theirs = sum(cost.seconds for cost in known.values()), sum(COSTS[part].seconds for part in known)
        self._costs = {
            part: known.get(part) or COSTS[part]._replace(seconds=COSTS[part].seconds * (ours / theirs if known else 1))
            for part in parts
        }
        self.total_s = sum(cost.seconds for cost in self._costs.values())
        self.is_measured = bool(known)
        self._part, self._before = "", 0

    def update(self, part: str, kernels: int, passed_s: float) -> tuple[int, int, float]:
        """After a kernel: how many of its part are done, of about how many, and the seconds that are left of all parts.

        Args:
            part: that is being compiled.
            kernels: compiled so far, of all parts.
            passed_s: since the beginning.
        """
        if part != self._part:
            self._part, self._before = part, kernels
        names = list(self._costs)
        cost, ahead = self._costs[part], names[names.index(part) :]
        made = kernels - self._before
        share = min(made / cost.kernels, 1.0)
        left_s = sum(self._costs[name].seconds for name in ahead) - share * cost.seconds
        done_s = self.total_s - left_s
        return made, cost.kernels, left_s * (passed_s + _PRIOR_S) / (done_s + _PRIOR_S)


def remembered_costs() -> dict[str, PartCost]:
    """What parts took on this computer when they were last compiled as a whole; nothing where that is not known."""
    try:
        noted = json.loads(_times_file().read_text(encoding="utf-8"))
        costs = {part: PartCost(int(noted[part][0]), float(noted[part][1])) for part in PARTS if part in noted}
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return {}
    return {part: cost for part, cost in costs.items() if cost.kernels > 0 and 0 < cost.seconds < _LONGEST_S}


def _remember(part: str, cost: PartCost) -> None:
    """For the next estimate; where it cannot be written there is none."""
    known = remembered_costs()
    if cost.kernels < _WHOLE_SHARE * (known.get(part) or COSTS.get(part, cost)).kernels:
        return
    with suppress(OutputError):
        write_text(_times_file(), json.dumps({**known, part: cost}) + "\n")


def _times_file() -> Path:
    return _mark("wheels").with_name(_TIMES)


def _compile(part: str) -> Generator[int]:
    """Compile a part in another process; yields how many kernels were compiled so far. Raises OutputError."""
    command = [sys.executable, "-m", "wheelsight.pipeline._compile", part]
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    # In a session of its own Ctrl-C reaches it through us alone, and leaves no traceback behind.
    child = subprocess.Popen(
        command,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert child.stdout is not None
        for line in child.stdout:
            yield int(line.split()[1])
        _, problem = child.communicate()
    except BaseException:
        child.kill()
        child.communicate()
        raise
    if child.returncode:
        last = (problem.strip().splitlines() or ["it ended without a word"])[-1]
        raise OutputError(f"kernels could not be compiled: {last}", fix="NUMBA_CACHE_DIR: where they are to be kept")


def mark_compiled(part: str) -> None:
    """Note that all kernels of a part are on the disk: how many files each folder of them has. Raises OutputError."""
    folders = {str(folder): len(list(folder.glob("*.nbi"))) for folder in _folders()}
    write_text(_mark(part), json.dumps({"kernels": _digest(), "folders": folders}) + "\n")


def _is_compiled(part: str) -> bool:
    try:
        noted = json.loads(_mark(part).read_text(encoding="utf-8"))
        folders = {Path(folder): int(count) for folder, count in noted["folders"].items()}
        return noted["kernels"] == _digest() and all(
            len(list(folder.glob("*.nbi"))) >= count for folder, count in folders.items()
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def _are_kernels() -> bool:
    """Whether anything is compiled at all: with NUMBA_DISABLE_JIT nothing is."""
    import numba

    return not numba.config.DISABLE_JIT  # type: ignore[attr-defined]


def _mark(part: str) -> Path:
    folder = min(_caches(import_module("wheelsight.geometry.motion_kernels")))
    return folder / _MARK.format(part)


def _folders() -> set[Path]:
    """The caches of all kernels that were loaded by now."""
    loaded = [(name, module) for name, module in sys.modules.items() if name.startswith("wheelsight.")]
    return set().union(*(_caches(module) for name, module in loaded if name.endswith("kernels")))


def _caches(module: ModuleType) -> set[Path]:
    """Where numba keeps the kernels that a module knows by name; only it can tell."""
    return {Path(kernel.stats.cache_path) for kernel in vars(module).values() if hasattr(kernel, "stats")}


def kernel_files() -> list[Path]:
    """All files that compiled kernels are made of, sorted."""
    return sorted(path for pattern in _KERNEL_FILES for path in PACKAGE.rglob(pattern))


def _digest() -> str:
    """What compiled kernels depend on: their files, the compiler and the processor."""
    import numba
    from llvmlite import binding

    facts = [sys.version, numba.__version__, binding.get_host_cpu_name()]
    for path in kernel_files():
        about = path.stat()
        facts.append(f"{path.relative_to(PACKAGE)} {about.st_size} {about.st_mtime_ns}")
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()
