"""Compiles kernels before they are needed, in a separate process. The rehearsal is a small drive that calls every
kernel that a run may need.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from wheelsight.app.run.run_record import RealTimeRecord
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import OutputError, WheelsightError
from wheelsight.core.files import write_text
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import RecordingWriter
from wheelsight.mapping import SurfelMap, Surfels
from wheelsight.slam.settings import FROM_KEYFRAMES

# Numba compiles a kernel at its first call and caches it on disk. A separate process runs the rehearsal, so that later
# runs find all kernels compiled. Compiling takes half a gigabyte, which is free again when the process ends. The
# measured time is stored beside the kernels.


PACKAGE = Path(__file__).parents[2]
SIMULATOR = PACKAGE.parent / "wheelsight_sim"
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
    "loops": ({"odometry": "dense", "map": "surfels", "loops.source": FROM_KEYFRAMES, "loops.apart_s": 0.0},),
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
    import numba

    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # set by NUMBA_DISABLE_JIT: nothing is compiled
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
        # Store it for the next estimate, if possible
        cost = PartCost(made, time.monotonic() - began_s)
        known = remembered_costs()
        if not (cost.kernels < _WHOLE_SHARE * (known.get(part) or COSTS.get(part, cost)).kernels):
            with suppress(OutputError):
                write_text(_times_file(), json.dumps({**known, part: cost}) + "\n")


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


def _times_file() -> Path:
    return _mark("wheels").with_name(_TIMES)


def _compile(part: str) -> Generator[int]:
    """Compile a part in another process; yields how many kernels were compiled so far. Raises OutputError."""
    command = [sys.executable, "-m", "wheelsight.app.run.kernel_process", part]
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
    loaded = [
        module
        for name, module in sys.modules.items()
        if name.startswith(("wheelsight.", "wheelsight_sim.")) and name.endswith("kernels")
    ]
    caches = set().union(*map(_caches, loaded))
    folders = {str(folder): len(list(folder.glob("*.nbi"))) for folder in caches}
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


def _mark(part: str) -> Path:
    folder = min(_caches(import_module("wheelsight.core.geometry.motion_kernels")))
    return folder / _MARK.format(part)


def _caches(module: ModuleType) -> set[Path]:
    """Where numba caches the kernels that a module knows by name. Only numba knows these paths."""
    return {Path(kernel.stats.cache_path) for kernel in vars(module).values() if hasattr(kernel, "stats")}


def kernel_files() -> list[Path]:
    """All files that compiled kernels are made of, sorted."""
    return sorted(
        path for pattern in _KERNEL_FILES for package in (PACKAGE, SIMULATOR) for path in package.rglob(pattern)
    )


def _digest() -> str:
    """What compiled kernels depend on: their files, the compiler and the processor."""
    import numba
    from llvmlite import binding

    facts = [sys.version, numba.__version__, binding.get_host_cpu_name()]
    for path in kernel_files():
        about = path.stat()
        facts.append(f"{path.relative_to(PACKAGE.parent)} {about.st_size} {about.st_mtime_ns}")
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()


# The rehearsal: a small drive that calls every kernel that a run may need. The robot drives an arc through a painted
# room. On the way the camera is covered, a wheel slips, the robot is kidnapped, a counter jumps and the image is dark.


# Small: images of 320×240 call the same kernels and take more than twice the time.
_CAMERA = PinholeCamera(160, 120, 131.0, 130.0, 80.0, 60.0)
_BENT = PinholeCamera(160, 120, 131.0, 130.0, 80.0, 60.0, (0.1, -0.1, 0.001, 0.001, 0.01))
_MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
LOW, HIGH = np.array([-2.5, -2.0, 0.0]), np.array([2.5, 2.0, 2.6])
_CELL_M = 0.24  # corners for keypoints, and large enough to be seen at half resolution
_STEP_S, _STEPS_A_FRAME = 0.02, 5
_DEEPEST_M = 8.0


@dataclass(frozen=True, slots=True)
class _Leg:
    """A number of frames at one speed and turn rate; the left wheel turns `slip` times as far as it rolls."""

    frames: int
    v_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0
    slip: float = 1.0
    is_covered: bool = False
    is_dark: bool = False
    carried_m: float = 0.0


_LEGS = (
    *(_Leg(6), _Leg(14, 0.5, 0.2), _Leg(6, 0.4, -0.9), _Leg(8, 0.4, 0.3, is_covered=True), _Leg(8, 0.4, 0.2)),
    *(_Leg(8, 0.3, 0.0, slip=3.0), _Leg(5, 0.3), _Leg(4, carried_m=0.15), _Leg(5, 0.2, 0.5, is_dark=True), _Leg(5)),
)


def write_rehearsal(folder: Path, *, is_registered: bool) -> None:
    """Write the drive, by a camera with a rolling shutter: of one pixel grid, or of two, with a lens that distorts."""
    with RecordingWriter(folder, _calibration(is_registered)) as writer:
        stamps_s, poses = [], []
        for stamp_s, T_odom_base, events in _drive():
            stamps_s.append(stamp_s)
            poses.append(T_odom_base)
            for event in events:
                writer.add(event)
        writer.add_ground_truth(Trajectory(np.array(stamps_s), np.array(poses), body="base"))


class DrawnDrive:
    """The same drive without a disk, as a source of events.

    Args:
        like: the sensors of the robot that is to be rehearsed for: what it lacks, the drive lacks.
    """

    name, warnings = "rehearsal", ()

    def __init__(self, like: Calibration) -> None:
        own = _calibration(like.is_registered)
        if like.color is None:
            own = replace(own, color=None, depth=None, T_color_depth=None)
        if like.wheels is None:
            own = replace(own, wheels=None)
        self.calibration = own if like.T_base_camera is not None else replace(own, T_base_camera=None)

    def events(self, *, images: bool = True) -> Iterator[Event]:
        """As any source has them."""
        has_wheels = self.calibration.wheels is not None
        for _, _, events in _drive(images):
            yield from (event for event in events if has_wheels or isinstance(event, RgbdFrame))

    def rehearsal(self) -> Iterator[Event]:
        """All of it."""
        return self.events(images=self.calibration.color is not None)


def _drive(images: bool = True) -> Iterator[tuple[float, FloatArray, list[Event]]]:
    """Stamp, T_odom_base and events, reading by reading; frames are drawn only if asked for."""
    for index, (stamp_s, T_odom_base, leg, ticks, is_frame) in enumerate(_steps()):
        events: list[Event] = [YawRate(stamp_s, leg.yaw_rate_rad_s), WheelTicks(stamp_s, *ticks)]
        if is_frame and images:
            # Colour (H, W, 3) and depth (H, W) on a leg
            seen, seen_m = seen_from(T_odom_base)
            if leg.is_dark or leg.is_covered:
                seen = np.zeros_like(seen)
            color, depth_m = seen, np.zeros_like(seen_m) if leg.is_covered else seen_m
            events.append(RgbdFrame(stamp_s + 1e-3, color, depth_m, index // _STEPS_A_FRAME))
        yield stamp_s, T_odom_base, events


def _calibration(is_registered: bool) -> Calibration:
    robot: dict[str, Any] = {
        "wheels": WHEELS,
        "T_base_camera": _MOUNT,
        "rolling_shutter_s": 0.02,
        "source": "rehearsal",
    }
    if is_registered:
        return Calibration.registered_camera(_CAMERA, **robot)
    beside = se3.from_parts(np.eye(3), np.array([0.002, 0.0, 0.0]))
    return Calibration(_BENT, _CAMERA, beside, color_sigma_px=1.0, **robot)


def _steps() -> Iterator[tuple[float, FloatArray, _Leg, tuple[int, int], bool]]:
    """Stamp, T_odom_base, leg, counters and whether a frame is due, reading by reading."""
    x, y, yaw, left_m, right_m, index = -1.6, -0.4, 0.1, 0.0, 0.0, 0
    for leg in _LEGS:
        y += leg.carried_m
        for _ in range(leg.frames * _STEPS_A_FRAME):
            across_m_s = leg.yaw_rate_rad_s * WHEELS.track_width_m / 2
            left_m += leg.slip * (leg.v_m_s - across_m_s) * _STEP_S
            right_m += (leg.v_m_s + across_m_s) * _STEP_S
            x, y = x + leg.v_m_s * _STEP_S * np.cos(yaw), y + leg.v_m_s * _STEP_S * np.sin(yaw)
            yaw += leg.yaw_rate_rad_s * _STEP_S
            ticks = (round(left_m / WHEELS.left_m_per_tick), round(right_m / WHEELS.right_m_per_tick))
            yield index * _STEP_S, se3.from_plane(x, y, yaw), leg, ticks, index % _STEPS_A_FRAME == 0
            index += 1


def seen_from(T_odom_base: FloatArray, camera: PinholeCamera | None = None) -> tuple[ByteArray, Float32Array]:
    """Colour (H, W, 3) and depth (H, W) of the box from inside, where the base is at (4, 4); None: its own camera."""
    camera = camera or _CAMERA
    T_odom_camera = T_odom_base @ _MOUNT
    rays = camera.rays() @ T_odom_camera[:3, :3].T
    origin = T_odom_camera[:3, 3]
    rays = np.where(rays == 0, 1e-9, rays)
    ways = np.where(rays > 0, (HIGH - origin) / rays, (LOW - origin) / rays)
    axis = ways.argmin(axis=-1)
    depth_m = np.take_along_axis(ways, axis[..., None], axis=-1)[..., 0]
    points = origin + rays * depth_m[..., None]
    cells = np.floor(points / _CELL_M).astype(int)
    np.put_along_axis(cells, axis[..., None], 40 * axis[..., None], axis=-1)  # a wall's own distance says nothing
    shade = (cells @ np.array([7919, 104729, 1299709])) % 1009
    color = np.stack([40 + shade % 97 * 2, 40 + shade % 89 * 2, 40 + shade % 101 * 2], axis=-1).astype(np.uint8)
    return color, depth_m.clip(max=_DEEPEST_M).astype(np.float32)


def floor_map() -> SurfelMap:
    """A square of a floor, 0.3 m wide and between two layers of voxels, where a mesh crosses zero."""
    across, along = np.meshgrid(np.arange(0, 0.3, 0.01), np.arange(0, 0.3, 0.01))
    n = across.size
    position = np.column_stack([across.ravel(), along.ravel(), np.full(n, 0.011)]).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    radius_m, grey, confidence, variance_m2 = (np.full(n, x, np.float32) for x in (0.01, 128, 50, 1e-6))
    color, stamps_s = np.full((n, 3), 128, np.float32), np.zeros(n)
    surfel_map = SurfelMap()
    seen = (stamps_s, stamps_s, np.full(n, -1, np.int32))
    surfel_map.add(Surfels(position, normal, radius_m, color, grey, confidence, variance_m2, *seen), stamp_s=0.0)
    return surfel_map


class Rehearses(EventSource, Protocol):
    """A source with events to rehearse by; a run's own localizers must not process them."""

    def rehearsal(self) -> Iterable[Event]:
        """The events, at once."""


@runtime_checkable
class InRealTime(EventSource, Protocol):
    """A source whose events come when their time comes: frames that come too fast for a run are dropped."""

    def rehearsals(self) -> Sequence[Rehearses]:
        """What is rehearsed before its first event, in this order."""

    def report(self) -> RealTimeRecord:
        """How it went so far."""

    def lately(self) -> tuple[float, float] | None:
        """Frames answered a second, and their median latency in seconds, over the last of them; None before two."""

    @property
    def frames_so_far(self) -> tuple[int, int]:
        """Frames that came by, and how many of them were dropped."""

    @property
    def is_missing_wheels(self) -> bool:
        """Whether wheels that are listened to have fallen silent."""


def rehearse(source: Rehearses, localizers: Sequence[Localizer]) -> None:
    """Answer the events of a rehearsal, and forget the answers."""
    events: Iterator[Event] = iter(source.rehearsal())
    with suppress(WheelsightError):  # errors of the source are reported when the run reads it
        for event in events:
            for localizer in localizers:
                localizer.process(event)
    for localizer in localizers:
        localizer.close()
