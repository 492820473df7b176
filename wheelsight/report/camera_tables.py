"""Tables of a camera calibration, for its page and for the terminal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from wheelsight.camera_calibration.result import CameraCalibration, DepthResiduals
from wheelsight.geometry import PinholeCamera, so3

HEAD = ("", "found", "± σ")
_BANDS_M = (0.0, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 10.0)
_FEWEST_CELLS = 20
_BROWN = ("k1", "k2", "p1", "p2", "k3")


def lens_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row a number that was sought, with its σ."""
    rows = _of_lens("colour", found.color, "color", found)
    if found.depth is not None and found.T_color_depth is not None:
        rows += _of_lens("depth", found.depth, "depth", found)
        T = found.T_color_depth
        turns_deg = np.degrees(so3.log(T[:3, :3]))
        for axis, way_m in zip("xyz", T[:3, 3], strict=True):
            rows.append((f"T_color_depth {axis}", f"{1e3 * way_m:.2f} mm", _sigma(found, f"T.{axis}", 1e3, " mm")))
        for axis, turn_deg in zip("xyz", turns_deg, strict=True):
            sigma = _sigma(found, f"T.turn_{axis}_deg", 1, "°")
            rows.append((f"turn about {axis}", f"{turn_deg:.3f}°", sigma))
    if not found.board.is_size_known:
        side = f"{1e3 * found.board.square_m:.2f} mm, by depth's scale"
        rows.append(("side of a square", side, _sigma(found, "square", 1e3, " mm")))
    rows.append(("colour corners, RMS", f"{found.color_residuals.rms_px:.3f} px", ""))
    if len(found.infrared_residuals.px):
        rows.append(("infrared corners, RMS", f"{found.infrared_residuals.rms_px:.3f} px", ""))
    return rows


def distance_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row a band of distances: depth less the plane's before and after, its scatter, and σ of the correction."""
    rows: list[tuple[str, ...]] = []
    for low, high, inside in bands(found.depth_residuals):
        off, before = found.depth_residuals.off_m[inside], found.depth_residuals.before_m[inside]
        sigma = ""
        if len(found.depth_sigma_m):
            middle_m = float(np.median(found.depth_residuals.depth_m[inside]))
            sigma = f"{1e3 * np.interp(middle_m, *found.depth_sigma_m.T):.1f} mm"
        rows.append(
            (
                f"{low:g} to {high:g} m",
                f"{1e3 * before.mean():+.1f} mm",
                f"{1e3 * off.mean():+.1f} mm",
                f"{1e3 * off.std():.1f} mm",
                sigma,
            )
        )
    return rows


def bands(depth: DepthResiduals) -> list[tuple[float, float, np.ndarray]]:
    """Bands of distance with enough cells: from, to, and which (N,)."""
    found = []
    for low, high in pairwise(_BANDS_M):
        inside = (depth.depth_m >= low) & (depth.depth_m < high)
        if np.count_nonzero(inside) >= _FEWEST_CELLS:
            found.append((low, high, inside))
    return found


def view_rows(found: CameraCalibration) -> list[tuple[str, ...]]:
    """A row a view: its distance, tilt, corners' RMS and mean depth less the plane's."""
    rms = found.color_residuals.of_views(len(found.views))
    rows: list[tuple[str, ...]] = []
    for k, view in enumerate(found.views):
        n = view.T_color_board[:3, 2]
        off = found.depth_residuals.off_m[found.depth_residuals.view == k]
        rows.append(
            (
                view.name,
                f"{view.distance_m:.2f} m",
                f"{np.degrees(np.arccos(np.clip(n[2], -1, 1))):.0f}°",
                str(len(view.corners.ids)),
                f"{rms[k]:.3f} px",
                f"{1e3 * off.mean():+.1f} mm" if len(off) else "none",
            )
        )
    return rows


def _of_lens(name: str, lens: PinholeCamera, key: str, found: CameraCalibration) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        (f"{name} {field}", f"{getattr(lens, field):.2f} px", _sigma(found, f"{key}.{field}", 1, " px"))
        for field in ("fx", "fy", "cx", "cy")
    ]
    for number, value in zip(_BROWN, lens.distortion, strict=True):
        if f"{key}.{number}" in found.sigmas:
            rows.append((f"{name} {number}", f"{value:.4f}", _sigma(found, f"{key}.{number}", 1, "")))
    return rows


def _sigma(found: CameraCalibration, name: str, factor: float, unit: str) -> str:
    return f"{factor * found.sigmas[name]:.2g}{unit}" if name in found.sigmas else ""
