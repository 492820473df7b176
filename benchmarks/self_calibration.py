"""`python -m benchmarks.self_calibration`: units of the simulator as they come, each calibrated by its own lap.

Each unit drives through a world or a plan (`wheelsight simulate --realism real`), its map is made with what its owner
believes (`wheelsight run --map surfels --loops keyframes`), and `calibrate_self` is judged by the truth: depth of
frontal walls without noise, rays of depth's pixels, mount, wheels, delay. Errors over σ show whether σ is honest: of
normal ones 95 % are below 2, and their mean square (NEES over its dimension) is 1.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.unit_views import bench_of
from wheelsight.core.calibration import Calibration, load_calibration
from wheelsight.core.geometry import FloatArray
from wheelsight_calibration.base import mount_values
from wheelsight_calibration.self_calibration import SelfCalibration, calibrate_self
from wheelsight_sim import SimulationSettings

DISTANCES_M = (0.8, 1.2, 2.0, 3.0, 4.0)
_UNITS = (("kinect-v1", "flat", 1), ("kinect-v1", "flat", 7), ("kinect-v2", "flat", 3), ("kinect-v2", "square", 2))
_SIZE, _RATE_HZ = (160, 120), 5.0


@dataclass(frozen=True, slots=True)
class Figure:
    """A quantity's error before and after, and its σ; all in one unit."""

    name: str
    unit: str
    before: float
    after: float
    sigma: float
    prior_sigma: float

    def __str__(self) -> str:
        text = f"{self.name}: off by {self.before:+.2f} {self.unit}, then {self.after:+.2f}"
        if not np.isfinite(self.sigma):
            return text
        over = self.after / self.sigma
        return f"{text} (σ {self.sigma:.2f}, {over:+.1f}σ; before it {self.prior_sigma:.2f})"


def drive(camera: str, world: str, seed: int, folder: Path) -> tuple[Path, Path]:
    """The recording of a unit's lap and the run with its map, made if they are not there."""
    recording, run = folder / f"{camera}-{world}-{seed}", folder / f"{camera}-{world}-{seed}-run"
    if not (run / "joined" / "map").is_dir():
        size = ["--size", f"{_SIZE[0]}x{_SIZE[1]}", "--rate", str(_RATE_HZ)]
        unit = ["--camera", camera, "--seed", str(seed), "--gyro", "--stop-and-turn"]
        _wheelsight("simulate", world, *unit, *size, "--out", str(recording), "--force")
        _wheelsight("run", str(recording), "--map", "surfels", "--loops", "keyframes", "--out", str(run), "--force")
    return recording, run


def _wheelsight(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "wheelsight", *words], check=True, stdout=subprocess.DEVNULL)


def judged(found: SelfCalibration, settings: SimulationSettings, true: Calibration) -> list[Figure]:
    """Each quantity beside the truth."""
    model, figures = found.model, list[Figure]()
    sigma_of = dict(zip(model.names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    prior_of = dict(zip(model.names, np.sqrt(np.diag(model.prior)).tolist(), strict=True))
    old, new = model.calibration, found.calibration
    px, J = _pixels(old), model.depth_at(np.array(DISTANCES_M))
    count = model.camera_count
    C, P = found.covariance[:count, :count], model.prior[:count, :count]
    for k, z in enumerate(DISTANCES_M):
        before, after = (depth_off_m(settings, one, px, z) for one in (old, new))
        sigma, prior = (1e3 * float(np.sqrt(J[k] @ M @ J[k])) for M in (C, P))
        means = [1e3 * float(np.nanmean(off)) for off in (before, after)]
        figures.append(Figure(f"depth at {z:g} m, mean", "mm", means[0], means[1], sigma, prior))
        rms = [1e3 * float(np.sqrt(np.nanmean(off**2))) for off in (before, after)]
        figures.append(Figure(f"depth at {z:g} m, RMS", "mm", rms[0], rms[1], np.inf, np.inf))
    wanted = _rays_of_depth(settings, px)
    offs = [_ray_change(one, px, wanted) for one in (old, new)]
    for k, (name, factor) in enumerate((("focal_length", 100.0), ("centre_x", 1e3), ("centre_y", 1e3))):
        values = factor * float(offs[0][k]), factor * float(offs[1][k])
        sigmas = factor * sigma_of[name], factor * prior_of[name]
        figures.append(Figure(name, "%" if k == 0 else "mrad", *values, *sigmas))
    if model.has_mount:
        T = [one.T_base_camera for one in (true, old, new)]
        real, before_of, after_of = (mount_values(np.asarray(one)) for one in T)
        for name, value in real.items():
            factor = 1e3 if name in ("x", "y", "height") else 180 / np.pi
            offs_of = factor * (before_of[name] - value), factor * (after_of[name] - value)
            unit = "mm" if factor == 1e3 else "°"
            figures.append(Figure(name, unit, *offs_of, factor * sigma_of[name], factor * prior_of[name]))
    if model.has_wheels:
        assert true.wheels is not None
        assert old.wheels is not None
        assert new.wheels is not None
        for name in ("left_radius", "right_radius", "track_width"):
            size = getattr(true.wheels, f"{name}_m")
            shares = [100 * (getattr(one, f"{name}_m") / size - 1) for one in (old.wheels, new.wheels)]
            figures.append(Figure(name, "%", shares[0], shares[1], 100 * sigma_of[name], 100 * prior_of[name]))
    return figures


def _pixels(calibration: Calibration) -> FloatArray:
    """(63, 2) whole pixels all over the image."""
    _, camera = calibration.cameras
    u, v = np.meshgrid(np.linspace(0.1, 0.88, 9) * camera.width, np.linspace(0.2, 0.9, 7) * camera.height)
    return np.rint(np.stack([u.ravel(), v.ravel()], axis=-1))


def depth_off_m(settings: SimulationSettings, calibration: Calibration, px: FloatArray, depth_m: float) -> FloatArray:
    """(N,) corrected depth less the true one, of a frontal wall; NaN where the unit sees nothing."""
    reading_m = bench_of(settings, settings.size).wall_m(depth_m)[px[:, 1].astype(int), px[:, 0].astype(int)]
    seen = reading_m > 0
    _, camera = calibration.cameras
    found = calibration.depth_error.of_readings(np.where(seen, reading_m, 1.0), px, camera)
    return np.where(seen, found - depth_m, np.nan)


def _rays_of_depth(settings: SimulationSettings, px: FloatArray, depth_m: float = 2.0) -> FloatArray:
    """(N, 2) true directions of what depth pixels show; a unit's registration is off by some pixels."""
    bench = bench_of(settings, settings.size)
    true, registration = bench.lens, bench.unit.registration
    seen_px = px
    if registration is not None:
        seen_px = px + registration.scale * (px - np.array([true.width, true.height]) / 2) + registration.offset_px
        seen_px = seen_px + registration.parallax_px_m / depth_m
    return np.asarray(true.normalise(seen_px))


def _ray_change(calibration: Calibration, px: FloatArray, wanted: FloatArray) -> FloatArray:
    """(3,) stretch and shift that the calibration's rays lack: their errors, with the sign of an error."""
    _, camera = calibration.cameras
    rays = camera.normalise(px)
    A = np.zeros((2 * len(px), 3))
    A[0::2, 0], A[1::2, 0], A[0::2, 1], A[1::2, 2] = rays[:, 0], rays[:, 1], 1.0, 1.0
    return -np.asarray(np.linalg.lstsq(A, (wanted - rays).ravel())[0])


def main(words: list[str] | None = None) -> None:
    """Calibrate the units, and print each one beside the truth."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.self_calibration", description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("self_calibration"), help="of drives; made if need be")
    parser.add_argument("--units", type=int, default=len(_UNITS), help="how many of the units")
    parsed = parser.parse_args(words)
    parsed.folder.mkdir(parents=True, exist_ok=True)
    ratios = list[float]()
    for camera, world, seed in _UNITS[: parsed.units]:
        recording, run = drive(camera, world, seed, parsed.folder)
        began_s = time.process_time()
        found = calibrate_self(run, wheels=recording)
        took_s = time.process_time() - began_s
        settings = SimulationSettings(world, camera, _SIZE, _RATE_HZ, seed=seed, realism="real")
        figures = judged(found, settings, load_calibration(recording / "truth" / "calibration.yaml"))
        pairs = found.held_out_pairs
        print(
            f"\n{camera}, {world}, seed {seed}: {found.views} views, {took_s:.0f} s of processor; held out "
            f"{1e3 * pairs.before:.1f} mm, then {1e3 * pairs.after:.1f}; {'taken' if found.is_better else 'not taken'}"
        )
        for figure in figures:
            print(f"  {figure}")
        ratios += [abs(one.after / one.sigma) for one in figures if np.isfinite(one.sigma)]
    over = np.array(ratios)
    print(
        f"\n{len(over)} numbers: {100 * (over < 2).mean():.0f} % within 2σ, largest {over.max():.1f}σ, "
        f"mean square {np.mean(over**2):.2f}"
    )


if __name__ == "__main__":
    main()
