"""`python -m benchmarks.camera_calibration`: cameras calibrated by boards, simulated with known truth, and real ones.

Simulated views are closed forms (`benchmarks.board_views`): corners with 0.1 px of noise, depth of a plate by ray and
plane with each sensor's noise and an error of another shape than the model's. A unit and its views come from one seed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.board_views import BOARD, RIGS, Rig, board_views
from benchmarks.sequences import default_data_folder
from benchmarks.table import Sheet, shown
from wheelsight.core.files import write_text
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3, so3
from wheelsight.core.settings.calibration import CameraCalibrationSettings, RefusalSettings
from wheelsight_calibration.board import board_from
from wheelsight_calibration.camera_model import CameraSetup
from wheelsight_calibration.cameras import CameraCalibration, calibrate_camera
from wheelsight_calibration.views import read_views

SEEDS, VIEWS = 10, 40
DISTANCES_M = (0.8, 1.2, 2.0, 3.0, 4.0)
# What it must reach: focal lengths, where the cameras are, and depth to 4 m.
MOST_FOCAL, MOST_APART_M, MOST_TURN_DEG, MOST_DEPTH_M = 2e-3, 1e-3, 0.1, 5e-3
MOST_REAL_PX = 0.3
_REAL = "calibration/kinect_v1_herrera_board"
# The board is in the image's middle in all views, which is refused otherwise.
_FOR_REAL = CameraCalibrationSettings(
    refusal=RefusalSettings(
        least_cover=0.05, focal_sigma=0.1, centre_sigma_px=50, apart_sigma_m=0.1, apart_sigma_deg=10, depth_sigma_m=0.2
    )
)
_PUBLISHED = 1.425e-3  # σ(z) / z², 1/m, of planes: Khoshelham & Elberink 2012
_MADE = (
    "Errors are against the truth: the largest of fx and fy of both lenses, way and turn between the cameras, and the "
    "mean over the image of corrected depth at 0.8, 1.2, 2, 3 and 4 m; the worst counts. Given are the "
    "median over the units and in brackets the worst. `in 3σ` counts all those numbers of all units by the σ that was "
    f"stated of each. To reach: focal lengths {100 * MOST_FOCAL:g} %, way {1e3 * MOST_APART_M:g} mm, turn "
    f"{MOST_TURN_DEG:g}°, depth {1e3 * MOST_DEPTH_M:g} mm, each within 3σ; on the real board {MOST_REAL_PX:g} px, and "
    "planes no rougher than published noise."
)


@dataclass(frozen=True, slots=True)
class UnitErrors:
    """Errors of one simulated unit, and every error over its stated σ."""

    rig: str
    seed: int
    focal: float
    apart_m: float
    turn_deg: float
    depth_m: float
    in_sigmas: dict[str, float]

    @property
    def misses(self) -> list[str]:
        """What is not as near as it must be, in words."""
        reported = (
            (self.focal, MOST_FOCAL, f"focal lengths {100 * self.focal:.2f} %"),
            (self.apart_m, MOST_APART_M, f"way {1e3 * self.apart_m:.2f} mm"),
            (self.turn_deg, MOST_TURN_DEG, f"turn {self.turn_deg:.3f}°"),
            (self.depth_m, MOST_DEPTH_M, f"depth {1e3 * self.depth_m:.1f} mm"),
        )
        return [words for value, most, words in reported if value > most]

    @property
    def unsaid(self) -> list[str]:
        """What is beyond 3σ, in words."""
        return [f"{name} {value:+.1f}σ" for name, value in self.in_sigmas.items() if abs(value) > 3]


def measure_unit(name: str, seed: int, views: int = VIEWS) -> UnitErrors:
    """Calibrate one unit by simulated views and compare."""
    rng = np.random.default_rng(seed)
    rig = RIGS[name](rng)
    found = calibrate_camera(board_views(rig, rng, views), BOARD, CameraSetup(rig.sensor, on_plate=True))
    assert found.depth is not None
    assert found.T_color_depth is not None
    lenses = (("color", found.color, rig.color), ("depth", found.depth, rig.depth))
    focal = max(abs(getattr(a, f) / getattr(b, f) - 1) for _, a, b in lenses for f in ("fx", "fy"))
    way_m = found.T_color_depth[:3, 3] - rig.T_color_depth[:3, 3]
    turn_rad = so3.log((found.T_color_depth @ se3.invert(rig.T_color_depth))[:3, :3])
    depth_m = np.array([depth_off_m(found, rig, z).mean() for z in DISTANCES_M])
    off = {f"{n}.{f}": _off(a, b, f) for n, a, b in lenses for f in ("fx", "fy", "cx", "cy")}
    off |= {f"T.{axis}": way_m[k] for k, axis in enumerate("xyz")}
    off |= {f"T.turn_{axis}_deg": np.degrees(turn_rad[k]) for k, axis in enumerate("xyz")}
    in_sigmas = {name: float(value / found.sigmas[name]) for name, value in off.items()}
    depth_sigma_m = np.interp(DISTANCES_M, *found.depth_sigma_m.T)
    in_sigmas |= {
        f"depth at {z:g} m": float(o / s) for z, o, s in zip(DISTANCES_M, depth_m, depth_sigma_m, strict=True)
    }
    return UnitErrors(
        name,
        seed,
        focal,
        float(np.linalg.norm(way_m)),
        float(np.degrees(np.linalg.norm(turn_rad))),
        float(np.abs(depth_m).max()),
        in_sigmas,
    )


def _off(a: PinholeCamera, b: PinholeCamera, name: str) -> float:
    return float(getattr(a, name) - getattr(b, name))


def depth_off_m(found: CameraCalibration, rig: Rig, z: float) -> FloatArray:
    """Corrected depth less the truth at so many metres, over the middle 80 % of the image (63,)."""
    assert found.depth is not None
    px, seen = rig.readings_at(z, found.depth_error, 0.1, (9, 7))
    return np.asarray(found.depth_error.of_readings(seen, px, found.depth) - z)


def simulated_sheet(units: Sequence[UnitErrors]) -> Sheet:
    """A line a sensor."""
    rows = []
    for name in dict.fromkeys(unit.rig for unit in units):
        some = [unit for unit in units if unit.rig == name]
        z = np.abs([value for unit in some for value in unit.in_sigmas.values()])
        rows.append(
            (
                name,
                _reported([100 * unit.focal for unit in some], "%", 2),
                _reported([1e3 * unit.apart_m for unit in some], "mm", 2),
                _reported([unit.turn_deg for unit in some], "°", 3),
                _reported([1e3 * unit.depth_m for unit in some], "mm", 1),
                f"{100 * (z <= 3).mean():.1f} %",
                f"{z.max():.1f}",
                f"{sum(not unit.misses for unit in some)} of {len(some)}",
            )
        )
    head = ("sensor", "focal lengths", "way", "turn", "depth", "in 3σ", "worst σ", "met")
    return Sheet(f"Simulated boards, {VIEWS} views a unit: median (worst)", head, tuple(rows))


def misses_sheet(units: Sequence[UnitErrors], real: CameraCalibration | None) -> Sheet:
    """What was not reached, a line each; first of all that is reported."""
    rows = [(f"{unit.rig}, unit {unit.seed}", ", ".join(unit.misses)) for unit in units if unit.misses]
    count = sum(len(unit.in_sigmas) for unit in units)
    rows += [
        (f"{unit.rig}, unit {unit.seed}", f"{', '.join(unit.unsaid)} (of {count} numbers of all units)")
        for unit in units
        if unit.unsaid
    ]
    if real is not None:
        if real.color_residuals.rms_px > MOST_REAL_PX:
            rows.append(("the real board", f"reprojection {real.color_residuals.rms_px:.2f} px"))
        rows += [
            (f"the real board, {reported}", f"planes {1e3 * scatter_m:.2f} mm, published {1e3 * published_m:.2f} mm")
            for reported, _, scatter_m, published_m in real_rows(real)
            if scatter_m > published_m
        ]
    return Sheet("Missed", ("of", "what"), tuple(rows) or (("nothing", "—"),))


def _reported(values: Sequence[float], unit: str, decimals: int) -> str:
    return f"{np.median(values):.{decimals}f} ({max(values):.{decimals}f}) {unit}"


def real_sheets(found: CameraCalibration) -> list[Sheet]:
    """The real board of a Kinect v1: its numbers, and what is left of depth by distance."""
    depth, step = found.depth_residuals, abs(found.depth_error.disparity_step_per_m)
    steps = depth.off_m / (step * depth.depth_m**2)
    assert found.depth is not None
    rows: list[tuple[str, str]] = [
        ("views used", str(len(found.views))),
        ("reprojection, RMS", f"{found.color_residuals.rms_px:.3f} px"),
        ("planes, RMS of cells", f"{steps.std():.2f} disparities"),
        ("colour fx", f"{found.color.fx:.1f} ± {found.sigmas['color.fx']:.1f} px"),
        ("depth fx", f"{found.depth.fx:.1f} ± {found.sigmas['depth.fx']:.1f} px"),
        (
            "side of a square, by depth's scale",
            f"{1e3 * found.board.square_m:.1f} ± {1e3 * found.sigmas['square']:.1f} mm",
        ),
    ]
    by_distance = [
        (reported, *(f"{1e3 * value_m:.1f} mm" for value_m in figures), "yes" if figures[1] <= figures[2] else "no")
        for reported, *figures in real_rows(found)
    ]
    head = ("distance", "before", "after", "published σ", "at most it")
    return [
        Sheet("A real board before a Kinect v1", ("", "found"), tuple(rows)),
        Sheet("Its depth less its planes, RMS of cells of 8 × 8 pixels", head, tuple(by_distance)),
    ]


def real_rows(found: CameraCalibration) -> list[tuple[str, float, float, float]]:
    """Distances, and RMS there before, after, and of the published noise, metres."""
    depth, rows = found.depth_residuals, []
    for low, high in ((0.8, 1.2), (1.2, 1.6), (1.6, 2.0), (2.0, 2.5), (2.5, 3.2)):
        inside = (depth.depth_m >= low) & (depth.depth_m < high)
        middle_m = float(np.median(depth.depth_m[inside]))
        before_m, after_m = (float(np.sqrt((part[inside] ** 2).mean())) for part in (depth.before_m, depth.off_m))
        rows.append((f"{low:g} to {high:g} m", before_m, after_m, _PUBLISHED * middle_m**2))
    return rows


def measure_real(data: Path) -> CameraCalibration | None:
    """The real board, or None where the recordings are missing."""
    folder = data / _REAL
    if not folder.is_dir():
        return None
    board = board_from("7x4:?")
    seen = read_views([folder], board)
    return calibrate_camera(seen, board, CameraSetup(on_plate=True), _FOR_REAL)


def main(words: Sequence[str] | None = None) -> None:
    """Measure, print, and keep if asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.camera_calibration")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="units of each sensor")
    parser.add_argument("--sensors", default=",".join(RIGS), help="with commas")
    parser.add_argument("--data", type=Path, default=default_data_folder(), help="folder of the real recordings")
    parser.add_argument("--out", type=Path, help="Markdown file for the tables")
    arguments = parser.parse_args(words)
    units = []
    for name in arguments.sensors.split(","):
        for seed in range(1, arguments.seeds + 1):
            units.append(measure_unit(name, seed))
            print(units[-1], file=sys.stderr, flush=True)
    real = measure_real(arguments.data)
    sheets = [misses_sheet(units, real), *([simulated_sheet(units)] if units else [])]
    sheets += real_sheets(real) if real is not None else []
    for sheet in sheets:
        Console(width=None if sys.stdout.isatty() else 160).print(sheet.to_rich())
    if arguments.out is not None:
        write_text(arguments.out, _document(sheets, arguments))


def _document(sheets: Sequence[Sheet], arguments: argparse.Namespace) -> str:
    about = machine.description()
    facts = [f"- {name}: {about[name]}" for name in ("Date", "System", "Versions")]
    seeds = f" --seeds {arguments.seeds}" if arguments.seeds != SEEDS else ""
    command = f"python -m benchmarks.camera_calibration{seeds} --out {shown(arguments.out)}"
    written = f"Written by `{command}`; how it measures: [Benchmarks](../benchmarks.md)."
    tables = [sheet.to_markdown() for sheet in sheets]
    return "\n".join(["# Calibration of cameras", "", written, "", *facts, "", _MADE, "", *tables])


if __name__ == "__main__":
    main()
