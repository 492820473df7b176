"""How long a user waits for the first mapped frame, with kernels to be compiled and with kernels kept."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.run import child_environment
from benchmarks.sequences import PROJECT
from benchmarks.table import Sheet
from benchmarks.targets import Target
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.messages import RgbdFrame

FIRST_S = 60.0
_PROGRAM = "from benchmarks.kernels import map_two_frames; map_two_frames()"
_SIZE = (640, 480)


@dataclass(frozen=True, slots=True)
class KernelTimes:
    """Seconds from a process's start until a frame is tracked against the map and fused.

    Attributes:
        compiling_s: nothing being compiled yet.
        cached_s: with what the first process left.
    """

    compiling_s: float
    cached_s: float


def measure_kernels() -> KernelTimes:
    """Two processes, one after the other, that share a folder for compiled kernels, empty at first."""
    with tempfile.TemporaryDirectory() as cache:
        return KernelTimes(*(_seconds(cache) for _ in range(2)))


def map_two_frames() -> None:
    """See one wall twice, with a lens, a shutter and a colour camera of its own, so that every kernel is called."""
    from wheelsight.config import load_config
    from wheelsight.estimation import Localizer

    camera = PinholeCamera(*_SIZE, 525.0, 525.0, 319.5, 239.5, (0.01, 0.0, 0.0, 0.0, 0.0))
    beside = np.eye(4)
    beside[0, 3] = -0.025
    single = Calibration.registered_camera(camera)
    for calibration in (single, replace(single, depth=camera, T_color_depth=beside, rolling_shutter_s=0.02)):
        localizer = Localizer(calibration, load_config(overrides={"odometry": "dense", "map": "surfels"}))
        for number in range(3):
            estimate = localizer.process(_frame(camera, number))
        assert estimate is not None
        assert estimate.T_odom_body is not None, estimate.reason
        assert se3.is_valid(estimate.T_odom_body, tolerance=1e-6)


def kernels_sheet(times: KernelTimes) -> Sheet:
    """Seconds before anything is mapped."""
    rows = (
        ("kernels compiled on the way, nothing kept", f"{times.compiling_s:.1f}"),
        ("kernels kept from before", f"{times.cached_s:.1f}"),
    )
    return Sheet("From a process's start to mapped frames, every kernel called", ("", "s"), rows)


def judge_kernels(times: KernelTimes) -> list[Target]:
    """What compiling may take."""
    return [Target("surfels: compiling all kernels and mapping the first frames", FIRST_S, times.compiling_s, "s")]


def _frame(camera: PinholeCamera, number: int) -> RgbdFrame:
    """A bulging wall with smooth paint."""
    x, y = np.moveaxis(camera.rays()[..., :2], -1, 0)
    depth_m = (2.0 + 0.3 * np.sin(3 * x) * np.cos(4 * y)).astype(np.float32)
    grey = 128 + 90 * np.sin(25 * x) * np.cos(21 * y) + number  # a camera never takes the same image twice
    return RgbdFrame(number / 30, np.repeat(grey[..., None], 3, axis=-1).astype(np.uint8), depth_m, number)


def _seconds(cache: str) -> float:
    begin = time.perf_counter()
    environment = child_environment() | {"NUMBA_CACHE_DIR": cache}
    subprocess.run([sys.executable, "-c", _PROGRAM], cwd=PROJECT, env=environment, check=True, capture_output=True)
    return time.perf_counter() - begin
