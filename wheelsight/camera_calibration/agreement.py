"""What agrees with a fit: standard deviations as residuals have them, and views, corners and cells left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wheelsight.camera_calibration.model import Sigmas
from wheelsight.camera_calibration.residuals import Residuals
from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.task import Counted
from wheelsight.camera_calibration.views import Corners
from wheelsight.geometry import BoolArray, FloatArray, IntArray

_POSE, _LENS, _OF_DEPTH = 6, 9, 3
_LEAST_FACTOR = 1e-3
_AS_BAD = 0.8
_LEAST_MEDIAN = 0.3  # in σ: of views that all agree better than they should, none is left out


def sigmas_of(residuals: Residuals, x: FloatArray) -> Sigmas:
    """Standard deviations as residuals have them, each freed of what its own parameters took of it."""
    model, before = residuals.model, residuals.sigmas

    def of(r: FloatArray, taken: int) -> float:
        return float(np.sqrt((r**2).sum() / max(r.size - taken, r.size / 4, 1))) if r.size else 1.0

    least = model.settings.detection.least_sigma_px
    return Sigmas(
        max(before.color_px * of(residuals.color(x), _POSE * model.count + _LENS), least),
        max(before.infrared_px * of(residuals.infrared(x), _LENS), least),
        max(before.depth * of(residuals.depth(x), _OF_DEPTH), _LEAST_FACTOR),
    )


def agreeing(counted: Counted, residuals: Residuals, x: FloatArray) -> Counted:
    """The views, corners and cells that agree with the rest."""
    model, robust = residuals.model, residuals.model.settings.robust
    color, infrared = (np.linalg.norm(block(x), axis=1) for block in (residuals.color, residuals.infrared))
    depth = np.abs(residuals.depth(x))
    gone: dict[int, str] = {}
    for off, view, factor, what in (
        (color, model.color.view, robust.view_factor, "corners in colour"),
        (infrared, model.infrared.view, robust.view_factor, "corners in infrared"),
        (depth, model.cells.view, robust.depth_view_factor, "depth"),
    ):
        # A view that moved pulls the depth of others off; that is judged once corners agree.
        for k, times in ({} if gone else _unlike(off, view, model.count, factor)).items():
            gone.setdefault(k, f"its {what} disagree with the other views': {times:.1f} times theirs")
    most = robust.corner_sigmas * np.sqrt(2)
    new_color = [
        _fewer(seen, color[model.color.view == k] <= most, model.settings) for k, seen in enumerate(counted.color)
    ]
    new_infrared = [
        None if seen is None else _fewer(seen, infrared[model.infrared.view == k] <= most, model.settings)
        for k, seen in enumerate(counted.infrared)
    ]
    cells = []
    for k, seen_cells in enumerate(counted.cells):
        kept = depth[model.cells.view == k] <= robust.cell_sigmas
        cells.append(seen_cells.only(kept))
    dropped = _corners(counted.color) + _corners(counted.infrared) - _corners(new_color) - _corners(new_infrared)
    new = replace(
        counted,
        color=tuple(new_color),
        infrared=tuple(new_infrared),
        cells=tuple(cells),
        dropped_corners=counted.dropped_corners + dropped,
        dropped_cells=counted.dropped_cells + len(depth) - sum(len(c.reading) for c in cells),
    )
    return new.without(gone)


def _unlike(off: FloatArray, view: IntArray, count: int, factor: float) -> dict[int, float]:
    """Views whose median is over `factor` times the usual view's, and how many times; one bad corner is no bad view."""
    medians = {k: float(np.median(off[view == k])) for k in range(count) if (view == k).any()}
    if not medians:
        return {}
    usual = max(float(np.median(list(medians.values()))), _LEAST_MEDIAN)
    # A bad view pulls good ones off with it: these are judged again without it, in the next round.
    least = max(factor * usual, _AS_BAD * max(medians.values()))
    return {k: value / usual for k, value in medians.items() if value > factor * usual and value >= least}


def _fewer(corners: Corners, kept: BoolArray, settings: CameraCalibrationSettings) -> Corners:
    """A view's corners without those that disagree, as long as enough are left."""
    enough = np.count_nonzero(kept) >= min(settings.detection.fewest_corners, len(kept))
    return corners.only(kept) if enough else corners


def _corners(views: tuple[Corners | None, ...] | list[Corners] | list[Corners | None]) -> int:
    return sum(0 if seen is None else len(seen.ids) for seen in views)
