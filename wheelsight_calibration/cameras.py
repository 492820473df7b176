"""`calibrate_camera` fits the cameras to views of a board and rejects views that do not determine them.
`CameraCalibration` holds the result, its uncertainty and its fields in a calibration file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from wheelsight.core.calibration import Calibration, Measured, calibration_fields
from wheelsight.core.calibration_parts import DepthNoise
from wheelsight.core.depth_errors import TERMS, DepthError, PointErrors, mode_of
from wheelsight.core.errors import CalibrationError
from wheelsight.core.geometry import FloatArray, IntArray, PinholeCamera, se3, so3
from wheelsight.core.settings.calibration import CameraCalibrationSettings, RefusalSettings
from wheelsight_calibration.board import Board
from wheelsight_calibration.camera_model import (
    DISPARITY_OF_INFINITY,
    NOMINAL_STEP,
    SIGMA_SHARE,
    CalibrationTask,
    CameraSetup,
    Counted,
    LensStart,
    Model,
    Sigmas,
    apart_by_planes,
    apart_by_poses,
    filled,
    lens_from_corners,
    model_of,
    plane_of,
    poses_in,
    usual_lens,
    with_cells,
)
from wheelsight_calibration.camera_solver import PRIOR_APART_M, Residuals, Solution, agreeing, sigmas_of, solve
from wheelsight_calibration.live_views import covered_share, distances, largest_tilt_deg
from wheelsight_calibration.solver import larger
from wheelsight_calibration.views import RAW_DISPARITY, Corners, ViewSet

# Share of the board's outline whose depth cells count, before and after the first estimate of the poses.
_SEED_SHARE, _BOARD_SHARE = 0.55, 0.95
_ROUGHLY = 1e-3  # relative tolerance of the cost for fits before outliers are removed
_AROUND_PX = 8
_ROUNDS = 3  # fits with outliers removed between them; later rounds remove no more
_SIGMA_PX = 0.15  # of a corner at first: OpenCV's sector-based detector has 0.1 to 0.2 on real boards
_FEWEST_VIEWS = 6  # three determine a lens (Zhang 2000); twice as many show disagreement
# Largest angle between two boards, without which focal length and distance are ambiguous (Zhang 2000, fig. 6: errors
# grow steeply below 20°), and ratio of the farthest board's distance to the nearest's, to separate scale and offset of
# depth.
_LEAST_TILT_DEG, _LEAST_DISTANCE_RATIO = 12.0, 1.3
_LARGEST_RMS_PX = 1.5  # of the remaining corners; more is a board of another shape
# σ of depth at the end of its range, relative to that at the farthest board, beyond which a warning asks for boards.
_BEYOND_FACTOR = 2.0
_STATED_TO_M = 4.0  # range of the stated σ of depth, with boards or without


def calibrate_camera(
    seen: ViewSet,
    board: Board,
    setup: CameraSetup | None = None,
    settings: CameraCalibrationSettings | None = None,
    on_step: Callable[[str], None] = lambda _: None,
) -> CameraCalibration:
    """Calibrate lenses, relative pose and depth error of an RGB-D camera by views of one board.

    It alternates fits and the removal of outliers, and rejects results that are too uncertain.

    Raises:
        CalibrationError: the views do not determine the calibration; the fix names the missing views.
        ConfigError: the setup does not fit the images.
    """
    task = CalibrationTask(seen, board, setup or CameraSetup())
    task.check()
    on_step("finding the lenses")
    counted, model, x = _begin(task, Counted.of(seen))
    keeps, refusal = task.setup.keeps_color, (settings or CameraCalibrationSettings()).refusal
    check_lens_views(model, x, counted.color, keeps, refusal.least_cover)
    sigmas = Sigmas(_SIGMA_PX, _SIGMA_PX, SIGMA_SHARE)
    for turn in range(_ROUNDS):
        on_step(f"fitting, round {turn + 1} of {_ROUNDS + 1}")
        residuals = Residuals(model, sigmas)
        solution = solve(residuals, x, _ROUGHLY)
        sigmas = sigmas_of(residuals, solution.x)
        before, counted = counted, agreeing(counted, Residuals(model, sigmas), solution.x)
        counted, model, x = _again(task, before, counted, model, solution, is_first=turn == 0)
    on_step("fitting what is left")
    residuals = Residuals(model, sigmas)
    x = solve(residuals, x, _ROUGHLY).x
    residuals = Residuals(model, sigmas_of(residuals, x))
    solution = solve(residuals, x)
    result = outcome(residuals, solution, board, counted)
    refuse_unsure(result, model, keeps, refusal)
    return replace(result, warnings=(*result.warnings, *warnings_beyond(result)))


def _begin(task: CalibrationTask, counted: Counted) -> tuple[Counted, Model, FloatArray]:
    seen, nominal = task.seen, task.setup.known_cameras
    if len(counted.views) < _FEWEST_VIEWS:
        problem = f"{len(counted.views)} views show the board, fewer than {_FEWEST_VIEWS}"
        raise CalibrationError(problem, fix="take more: near and far, tilted each way, all over the image")
    if task.setup.keeps_color and nominal is not None:
        color = poses_in(nominal.cameras[0], counted.color, task.board)
    else:
        color = lens_from_corners(counted.color, task.board, seen.color_size)
    counted, depth, T_color_depth = _depth_start(task, counted, color)
    square_m = task.first_square_m
    if seen.has_depth and not task.board.is_size_known:
        square_m = _square_by_depth(task, counted, depth, color.T_camera_board)
    T = _scaled(color.T_camera_board, square_m)
    if seen.has_depth:
        counted = with_cells(task, counted, se3.invert(T_color_depth) @ T, depth, square_m, _SEED_SHARE)
        if not seen.has_infrared and not task.setup.is_registered:
            planes = np.array([plane_of(c, task.nominal_m(c.reading), depth) for c in counted.cells])
            T_color_depth = apart_by_planes(T, planes, PRIOR_APART_M, T_color_depth)
    model = model_of(task, counted, (color.camera, depth), T_color_depth)
    x = np.zeros(model.slices()["poses"].stop)
    return counted, model, filled(model, x, (color.camera, depth), square_m, T)


def _depth_start(
    task: CalibrationTask, counted: Counted, color: LensStart
) -> tuple[Counted, PinholeCamera, FloatArray]:
    """Initial depth lens and T_color_depth, and infrared corners in the numbering of colour."""
    seen, nominal = task.seen, task.setup.known_cameras
    if seen.depth_size is None or task.setup.is_registered:
        return counted, color.camera, np.eye(4)
    both = [k for k, corners in enumerate(counted.infrared) if corners is not None]
    if not both:
        if nominal is not None:
            return counted, nominal.cameras[1], nominal.T_color_camera
        return counted, usual_lens(seen.depth_size), np.eye(4)
    corners = [seen_corners for seen_corners in counted.infrared if seen_corners is not None]
    lens = lens_from_corners(corners, task.board, seen.depth_size)
    T_color, T_depth, infrared = color.T_camera_board[both], lens.T_camera_board.copy(), list(counted.infrared)
    for index, k in enumerate(both):
        # A symmetric board may be numbered from its other end in the other image.
        if so3.angle(T_color[index, :3, :3] @ T_depth[index, :3, :3].T) > np.pi / 2:
            turned = corners[index].turned(task.board.count)
            infrared[k] = turned
            T_depth[index] = poses_in(lens.camera, [turned], task.board).T_camera_board[0]
    square_m = task.first_square_m
    apart = apart_by_poses(_scaled(T_color, square_m), _scaled(T_depth, square_m))
    return replace(counted, infrared=tuple(infrared)), lens.camera, apart


def _scaled(T: FloatArray, square_m: float) -> FloatArray:
    return se3.from_parts(T[..., :3, :3], T[..., :3, 3] * square_m)


def _square_by_depth(task: CalibrationTask, counted: Counted, depth: PinholeCamera, T_color_board: FloatArray) -> float:
    """Side of a square by depth in the middle of the boards, the median over views."""
    found = []
    for view, T in zip(counted.views, T_color_board, strict=True):
        if view.reading is None:
            continue
        middle = se3.apply(T, task.squares).mean(axis=0)
        u, v = np.round(depth.denormalise(middle[:2] / middle[2])).astype(int).tolist()
        rows, columns = (slice(max(at - _AROUND_PX, 0), max(at + _AROUND_PX + 1, 0)) for at in (v, u))
        around = view.reading[rows, columns]
        around = around[np.isfinite(around) & (around > 0)]
        if len(around):
            found.append(float(task.nominal_m(np.array([np.median(around)]))[0]) / middle[2])
    if not found:
        raise CalibrationError("no depth is seen where the boards are", fix="give the depth camera by --calibration")
    return float(np.median(found))


def _again(
    task: CalibrationTask, before: Counted, counted: Counted, model: Model, solution: Solution, *, is_first: bool
) -> tuple[Counted, Model, FloatArray]:
    """The model of the remaining views with the present parameters; the first round recomputes depth cells."""
    x = solution.x
    if len(counted.views) < _FEWEST_VIEWS:
        names = ", ".join(f"{name}: {reason}" for name, reason in counted.left_out[-2:])
        problem = f"only {len(counted.views)} views agree with each other; left out {names}"
        raise CalibrationError(problem, fix="hold board and camera still, and take more views")
    kept = [before.views.index(view) for view in counted.views]
    T = se3.from_parts(*model.poses_of(x))[kept]
    lenses, square_m = (model.color_camera(x), model.depth_camera(x)), model.square_of(x)
    if is_first and task.seen.has_depth:
        T_depth_board = se3.invert(model.T_color_depth_of(x)) @ T
        counted = with_cells(task, counted, T_depth_board, lenses[1], square_m, _BOARD_SHARE)
    new = model_of(task, counted, (model.color_start, model.depth_start), model.T_color_depth)
    if not is_first:
        new = replace(new, knots_m=model.knots_m)
    y = np.zeros(new.slices()["poses"].stop)
    for name in ("apart", "error"):
        old, place = x[model.slices()[name]], new.slices()[name]
        if len(old) == place.stop - place.start:
            y[place] = old
    return counted, new, filled(new, y, lenses, square_m, T)


def check_lens_views(
    model: Model, x: FloatArray, corners: Sequence[Corners], keeps_color: bool, least_cover: float
) -> None:
    """Raise CalibrationError if the geometry of the views leaves parameters undetermined; it names all causes."""
    T = se3.from_parts(*model.poses_of(x))
    problems, fixes = [], []
    if not keeps_color:
        tilt_deg = largest_tilt_deg(T)
        if tilt_deg < _LEAST_TILT_DEG:
            problems.append(f"all boards face the same way (tilts differ by {tilt_deg:.0f}°)")
            fixes.append("tilt the board by 30° to each side, up and down")
        size = model.color_start.width, model.color_start.height
        cover = covered_share([seen.px for seen in corners], size)
        if cover < least_cover:
            problems.append(f"boards are seen in {100 * cover:.0f} % of the image alone")
            fixes.append("bring the board near, and into every corner of the image; or --keep-color")
    if len(model.cells.px):
        nearest, farthest = distances(T)
        if farthest < _LEAST_DISTANCE_RATIO * nearest:
            problems.append(f"all boards are {nearest:.2f} to {farthest:.2f} m away")
            fixes.append("add views from twice as far")
    if problems:
        raise CalibrationError(f"the views do not determine it: {'; '.join(problems)}", fix="; ".join(fixes))


def refuse_unsure(found: CameraCalibration, model: Model, keeps_color: bool, settings: RefusalSettings) -> None:
    """Raise CalibrationError if a result is too uncertain; it names each parameter and its σ."""
    if found.color_residuals.rms_px > _LARGEST_RMS_PX:
        problem = f"corners are {found.color_residuals.rms_px:.1f} px off what any lens explains"
        raise CalibrationError(problem, fix="check the counts of --board, that it is flat, and that nothing moved")
    sigmas, limits = found.sigmas, []
    if not keeps_color:
        widths = model.color_start.width / 640
        limits += [("color.fx", settings.focal_sigma * found.color.fx, "px")]
        limits += [(name, settings.centre_sigma_px * widths, "px") for name in ("color.cx", "color.cy")]
    if found.depth is not None and "depth.fx" in sigmas:
        limits.append(("depth.fx", settings.focal_sigma * found.depth.fx, "px"))
    limits += [(f"T.{axis}", settings.apart_sigma_m, "m") for axis in "xyz"]
    limits += [(f"T.turn_{axis}_deg", settings.apart_sigma_deg, "°") for axis in "xyz"]
    unsure = [f"{name} (σ {sigmas[name]:.2g} {unit})" for name, most, unit in limits if sigmas.get(name, 0) > most]
    if len(found.depth_sigma_m):
        known = found.depth_sigma_m[found.depth_sigma_m[:, 0] <= _farthest_m(found)]
        worst = known[int(np.argmax(known[:, 1]))]
        if worst[1] > settings.depth_sigma_m:
            unsure.append(f"depth at {worst[0]:.1f} m (σ {1e3 * worst[1]:.0f} mm)")
    if unsure:
        fix = "add views: near and far, tilted to each side, in every corner of the image"
        raise CalibrationError(f"the views do not determine: {', '.join(unsure)}", fix=fix)


def warnings_beyond(found: CameraCalibration) -> tuple[str, ...]:
    """A warning if σ of depth beyond the farthest board is much larger than at that board."""
    if not len(found.depth_sigma_m):
        return ()
    farthest_m = _farthest_m(found)
    at_board_m = float(np.interp(farthest_m, *found.depth_sigma_m.T))
    end_m, at_end_m = found.depth_sigma_m[-1].tolist()
    if at_end_m <= _BEYOND_FACTOR * at_board_m:
        return ()
    known = f"Depth is known to {1e3 * at_board_m:.0f} mm where boards end, at {farthest_m:.1f} m,"
    return (f"{known} and to {1e3 * at_end_m:.0f} mm at {end_m:.1f} m: add boards that far if depth is used there.",)


def _farthest_m(found: CameraCalibration) -> float:
    """Distance of the farthest board, without single outlying cells."""
    return float(np.percentile(found.depth_residuals.depth_m, 99))


@dataclass(frozen=True, eq=False, slots=True)
class CornerResiduals:
    """Residuals of one camera's corners: view (N,), pixel (N, 2), and predicted minus detected (N, 2), pixels."""

    view: IntArray
    px: FloatArray
    off_px: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square distance of a corner; NaN without corners."""
        return float(np.sqrt((self.off_px**2).sum(axis=1).mean())) if len(self.px) else float("nan")

    def of_views(self, count: int) -> FloatArray:
        """Root mean square distance (count,) for each of `count` views."""
        total = np.bincount(self.view, (self.off_px**2).sum(axis=1), count)
        return np.asarray(np.sqrt(total / np.maximum(np.bincount(self.view, minlength=count), 1)))


@dataclass(frozen=True, eq=False, slots=True)
class DepthResiduals:
    """Residuals of depth cells: view (N,), pixel (N, 2), distance of the plane (N,), and residual (N,), metres.

    `off_m` is the corrected reading minus the distance. `before_m` (N,) is the same for uncorrected readings, with the
    nominal disparity model for raw disparities.
    """

    view: IntArray
    px: FloatArray
    depth_m: FloatArray
    off_m: FloatArray
    before_m: FloatArray

    @property
    def rms_m(self) -> float:
        """Root mean square residual; NaN without cells."""
        return float(np.sqrt((self.off_m**2).mean())) if len(self.off_m) else float("nan")


@dataclass(frozen=True, eq=False, slots=True)
class UsedView:
    """A used view: its name, corners in colour, and the board's pose in the colour camera (4, 4), metres."""

    name: str
    corners: Corners
    T_color_board: FloatArray

    @property
    def distance_m(self) -> float:
        """Distance of the board's origin along the optical axis."""
        return float(self.T_color_board[2, 3])


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """The result of `calibrate_camera`.

    Attributes:
        board: the board, with the estimated side of its squares if that was unknown.
        color, depth: the lenses; equal if depth is registered, and `depth` is None without depth.
        T_color_depth: (4, 4), or None if depth is registered or missing.
        depth_error: correction of depth readings.
        sensor: type of depth sensor, one of `views.SENSORS`, or `RAW_DISPARITY`.
        sigmas: standard deviations by name: color.fx, depth.cx, T.x, T.roll_deg, …
        depth_sigma_m: (K, 2) pairs of distance and standard deviation of corrected depth there.
        point_errors: errors of points in the colour camera's frame after calibration; None without depth.
        color_sigma_px: standard deviation of the colour pixel of a depth pixel, root mean square over the image.
        noise: (constant_m, quadratic_per_m) of a depth pixel, by the scatter on planes; None without depth.
        views: the used views.
        left_out: names of the other views, with reasons.
        color_residuals, infrared_residuals, depth_residuals: residuals.
        dropped_corners, dropped_cells: numbers of removed outliers.
        warnings: sentences for the user.
    """

    board: Board
    color: PinholeCamera
    depth: PinholeCamera | None
    T_color_depth: FloatArray | None
    depth_error: DepthError
    sensor: str
    sigmas: dict[str, float]
    depth_sigma_m: FloatArray
    point_errors: PointErrors | None
    color_sigma_px: float
    noise: tuple[float, float] | None
    views: tuple[UsedView, ...]
    left_out: tuple[tuple[str, str], ...]
    color_residuals: CornerResiduals
    infrared_residuals: CornerResiduals
    depth_residuals: DepthResiduals
    dropped_corners: int = 0
    dropped_cells: int = 0
    warnings: tuple[str, ...] = ()


_STEP = 1e-6
_BARE = ("fx", "fy", "cx", "cy")
_BROWN = ("k1", "k2", "p1", "p2", "k3")
_AXES = ("x", "y", "z")
_DISTANCES, _ACROSS, _DOWN = 12, 9, 7


def outcome(residuals: Residuals, solution: Solution, board: Board, counted: Counted) -> CameraCalibration:
    """The result of a solution: lenses, standard deviations by name, and residuals."""
    model, x = residuals.model, solution.x
    color, infrared = model.color, model.infrared
    R, t = model.poses_of(x)
    T = se3.from_parts(R, t)
    at = model.slices()
    has_depth = model.is_registered or at["apart"].stop > at["apart"].start
    depth, noise = _depth_residuals(residuals, x), None
    if len(model.cells.px):  # of one pixel: the assumed law, scaled to the scatter of pixels
        sigma_m = model.cells.scatter * depth.depth_m**2
        if model.sensor == RAW_DISPARITY:
            sigma_m = sigma_m * -NOMINAL_STEP
        constant, quadratic = model.noise
        factor = float(np.median(sigma_m / (constant + quadratic * depth.depth_m**2)))
        noise = factor * constant, factor * quadratic
    return CameraCalibration(
        board=replace(board, square_m=model.square_of(x)),
        color=model.color_camera(x),
        depth=model.depth_camera(x) if has_depth else None,
        T_color_depth=model.T_color_depth_of(x) if has_depth and not model.is_registered else None,
        depth_error=model.error_of(x),
        sensor=model.sensor,
        sigmas=sigmas_by_name(residuals, solution),
        depth_sigma_m=_depth_sigma(residuals, solution, depth),
        point_errors=point_modes(model, solution) if has_depth and len(model.cells.px) else None,
        color_sigma_px=_pixel_sigma(residuals, solution) if has_depth else 0.0,
        noise=noise,
        views=tuple(
            UsedView(view.name, seen, pose) for view, seen, pose in zip(counted.views, counted.color, T, strict=True)
        ),
        left_out=counted.left_out,
        color_residuals=CornerResiduals(color.view, color.px, residuals.color(x) * residuals.sigmas.color_px),
        infrared_residuals=CornerResiduals(
            infrared.view, infrared.px, residuals.infrared(x) * residuals.sigmas.infrared_px
        ),
        depth_residuals=depth,
        dropped_corners=counted.dropped_corners,
        dropped_cells=counted.dropped_cells,
    )


def sigmas_by_name(residuals: Residuals, solution: Solution) -> dict[str, float]:
    """Standard deviations of the parameters that a user knows, by name."""
    model, x, at = residuals.model, solution.x, residuals.at
    named: dict[str, float] = {}
    for name, camera, start in (
        ("color", model.color_camera(x), model.color_start),
        ("depth", model.depth_camera(x), model.depth_start),
    ):
        size = at[name].stop - at[name].start
        if not size:
            continue
        J = np.eye(size)
        J[0] *= camera.fx
        J[1, :2] = camera.fy
        J[2:4] *= start.fx
        sigmas = solution.sigmas_of(J, at[name]).tolist()
        named |= {f"{name}.{k}": s for k, s in zip((*_BARE, *_BROWN), sigmas, strict=False)}
    if at["apart"].stop > at["apart"].start:
        # A perturbation from the left changes the translation by v + ω × t.
        way = np.hstack([np.eye(3), -so3.hat(model.T_color_depth_of(x)[:3, 3])])
        turn = np.degrees(np.hstack([np.zeros((3, 3)), np.eye(3)]))
        sigmas = solution.sigmas_of(np.vstack([way, turn]), at["apart"]).tolist()
        named |= dict(
            zip([*(f"T.{axis}" for axis in _AXES), *(f"T.turn_{axis}_deg" for axis in _AXES)], sigmas, strict=True)
        )
    if model.square_m is None:
        named["square"] = float(solution.sigmas_of(np.full((1, 1), model.square_of(x)), at["square"])[0])
    return named


def _depth_residuals(residuals: Residuals, x: FloatArray) -> DepthResiduals:
    model = residuals.model
    if not len(model.cells.px):
        return DepthResiduals(np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))
    off_m, _ = residuals.depth_m(x)
    error, camera = model.error_of(x), model.depth_camera(x)
    corrected = error.of_readings(reading_m(error, model.cells.reading), model.cells.px, camera)
    depth_m = corrected - off_m
    raw = model.cells.reading
    if model.sensor == RAW_DISPARITY:
        raw = 1 / np.maximum(-NOMINAL_STEP * (DISPARITY_OF_INFINITY - raw), 1e-3)
    return DepthResiduals(model.cells.view, model.cells.px, depth_m, off_m, raw - depth_m)


def _depth_sigma(residuals: Residuals, solution: Solution, depth: DepthResiduals) -> FloatArray:
    """Pairs (K, 2) of distance and σ of corrected depth, root mean square over pixels.

    Distances go from the nearest cell to the farthest, or to the least range for which σ is stated.
    """
    model, x = residuals.model, solution.x
    at = model.slices()["error"]
    if not len(depth.depth_m) or at.stop == at.start:
        return np.empty((0, 2))
    nearest_m, farthest_m = np.percentile(depth.depth_m, (1, 99)).tolist()
    distances_m = np.linspace(nearest_m, max(farthest_m, _STATED_TO_M), _DISTANCES)
    camera, error = model.depth_camera(x), model.error_of(x)
    px = grid_px(camera, 3, 3)
    readings = readings_for(error, np.repeat(distances_m, len(px)), np.tile(px, (_DISTANCES, 1)), camera)

    def true_m(y: FloatArray) -> FloatArray:
        moved = model.error_of(y)
        return moved.of_readings(reading_m(moved, readings), np.tile(px, (_DISTANCES, 1)), camera)

    J = np.stack(_derivatives(true_m, x, range(at.start, at.stop)), axis=-1)
    sigmas = solution.sigmas_of(J, at).reshape(_DISTANCES, -1)
    return np.stack([distances_m, np.sqrt((sigmas**2).mean(axis=1))], axis=-1)


def _derivatives(f: Callable[[FloatArray], FloatArray], x: FloatArray, columns: Sequence[int]) -> list[FloatArray]:
    """Numeric derivatives of a function by some parameters."""
    here, steps = f(x), []
    for k in columns:
        y = x.copy()
        y[k] += _STEP
        steps.append((f(y) - here) / _STEP)
    return steps


def _pixel_sigma(residuals: Residuals, solution: Solution) -> float:
    """Standard deviation of the colour pixel of a depth pixel, root mean square over the image."""
    model, x = residuals.model, solution.x
    at = model.slices()
    if model.is_registered:
        return 0.0
    camera = model.depth_camera(x)
    T = se3.from_parts(*model.poses_of(x))
    px = grid_px(camera, _ACROSS, _DOWN)
    middle_m = np.full(len(px), float(np.median(T[:, 2, 3])))

    def color_px(y: FloatArray) -> FloatArray:
        p = model.depth_camera(y).back_project(px, middle_m)
        p = se3.apply(model.T_color_depth_of(y), p)
        return model.color_camera(y).denormalise(p[:, :2] / p[:, 2:]).ravel()

    columns = [*range(at["color"].start, at["color"].stop), *range(at["depth"].start, at["depth"].stop)]
    columns += range(at["apart"].start, at["apart"].stop)
    J = np.stack(_derivatives(color_px, x, columns), axis=-1)
    return float(np.sqrt(2 * (solution.sigmas_of(J, columns) ** 2).mean()))


_POINT_MODES_DISTANCES = 6
_NEAREST_M = 0.6  # where depth cameras of all kinds see
_KEPT = 0.999  # of the variance of points, over their distance
_TINY = 1e-9  # of the variance, so that it is positive in each direction


def point_modes(model: Model, solution: Solution) -> PointErrors:
    """The uncertainty of points in the colour camera's frame, as modes of one standard deviation each.

    A point follows from a reading by lens, depth error and pose between the cameras. The uncertainty of the colour lens
    is included: an error of that lens misplaces boards, and so the depth on them.
    """
    x, at = solution.x, model.slices()
    blocks = ("color", "error") if model.is_registered else ("depth", "apart", "error")
    columns = [k for name in blocks for k in range(at[name].start, at[name].stop)]
    # Readings all over the image and the distances.
    camera, distances_m = model.depth_camera(x), np.geomspace(_NEAREST_M, _STATED_TO_M, _POINT_MODES_DISTANCES)
    px = np.tile(grid_px(camera, _ACROSS, _DOWN), (_POINT_MODES_DISTANCES, 1))
    readings = readings_for(model.error_of(x), np.repeat(distances_m, _ACROSS * _DOWN), px, camera)

    def points(y: FloatArray) -> FloatArray:
        error, lens = model.error_of(y), model.depth_camera(y)
        seen_m = error.of_readings(reading_m(error, readings), px, lens)
        return np.asarray(se3.apply(model.T_color_depth_of(y), lens.back_project(px, seen_m)))

    here = points(x)
    modes = mode_of(here, np.stack(_derivatives(points, x, columns)))
    # An orthogonal basis of points over their distance makes the variances of coefficients comparable.
    unit = PointErrors(tuple(map(tuple, np.eye(TERMS).tolist()))).moved_m(here)
    _, R = np.linalg.qr((unit / here[None, :, 2:]).reshape(len(unit), -1).T)
    by_noise, by_views = (
        R @ modes.T @ C[np.ix_(columns, columns)] @ modes @ R.T for C in (solution.covariance, solution.by_views)
    )
    variances, directions = np.linalg.eigh(
        larger(by_noise, by_views + _TINY * np.trace(by_views) * np.eye(len(by_views)))
    )
    order = np.argsort(variances)[::-1]
    enough = int(np.searchsorted(np.cumsum(variances[order]) / variances.sum(), _KEPT)) + 1
    kept = order[:enough]
    found = np.linalg.solve(R, directions[:, kept] * np.sqrt(variances[kept])).T
    return PointErrors(tuple(map(tuple, found.tolist())))


def reading_m(error: DepthError, reading: FloatArray) -> FloatArray:
    """Readings in metres, still to be corrected, of readings in metres or of raw disparities."""
    if not error.is_of_disparity:
        return reading
    inverse = error.disparity_at_zero_per_m + error.disparity_step_per_m * reading
    return np.asarray(1 / np.maximum(inverse, 1e-3))


def readings_for(error: DepthError, depth_m: FloatArray, px: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Readings that are corrected to about these depths: raw disparities where the error is of them."""
    reading = depth_m.copy()
    for _ in range(5):
        reading = np.maximum(reading + depth_m - error.of_readings(reading, px, camera), 0.05)
    if not error.is_of_disparity:
        return reading
    return np.asarray((1 / reading - error.disparity_at_zero_per_m) / error.disparity_step_per_m)


def grid_px(camera: PinholeCamera, across: int, down: int) -> FloatArray:
    """Pixels (across · down, 2), evenly over a camera's image."""
    u, v = np.meshgrid(
        np.linspace(0.05, 0.95, across) * (camera.width - 1), np.linspace(0.05, 0.95, down) * (camera.height - 1)
    )
    return np.stack([u.ravel(), v.ravel()], axis=-1)


_CAMERA_PARTS = ("color", "depth", "T_color_depth", "depth_noise", "depth_error", "point_errors", "color_sigma_px")
# Depth cameras see on where no board was held; noise beyond is by the same law.
_LEAST_CONSTANT_M = 1e-4


def camera_calibration(found: CameraCalibration, nominal: Calibration | None = None) -> Calibration:
    """The cameras as a `Calibration`: depth's range, shutter, lateness and `frame_sigma`s stay `nominal`'s."""
    known = nominal if nominal is not None and nominal.color is not None else Calibration()
    constant_m, quadratic_per_m = found.noise or (known.depth_noise.constant_m, known.depth_noise.quadratic_per_m)
    noise = DepthNoise(
        max(constant_m, _LEAST_CONSTANT_M), quadratic_per_m, known.depth_noise.near_m, known.depth_noise.far_m
    )
    apart = found.T_color_depth
    return Calibration(
        color=found.color,
        depth=found.color if apart is None else found.depth,
        T_color_depth=apart,
        depth_noise=noise,
        depth_error=found.depth_error,
        point_errors=found.point_errors,
        color_sigma_px=found.color_sigma_px,
        rolling_shutter_s=known.rolling_shutter_s,
        depth_late_s=known.depth_late_s,
        frame_sigma_m=known.frame_sigma_m,
        frame_sigma_rad=known.frame_sigma_rad,
        source=f"cameras calibrated by {len(found.views)} views of a board",
    )


def camera_fields(found: CameraCalibration, nominal: Calibration | None = None) -> dict[str, Any]:
    """The fields that a calibration of cameras finds."""
    fields = calibration_fields(camera_calibration(found, nominal))
    return {name: fields[name] for name in _CAMERA_PARTS if name in fields}


def measured(command: str, found: CameraCalibration) -> Measured:
    """What a calibration of cameras is worth, for the history."""
    figures = {"views": float(len(found.views)), "reprojection_px": found.color_residuals.rms_px}
    figures |= {f"sigma {name}": found.sigmas[name] for name in ("color.fx", "depth.fx") if name in found.sigmas}
    if "T.x" in found.sigmas:
        figures["sigma_apart_m"] = float(np.sqrt(sum(found.sigmas[f"T.{axis}"] ** 2 for axis in "xyz")))
    if len(found.depth_residuals.off_m):
        figures["plane_rms_m"] = found.depth_residuals.rms_m
    if not found.board.is_size_known:
        figures["square_m"] = found.board.square_m
    what = "color" if found.depth is None else "color, depth" if found.T_color_depth is not None else "registered depth"
    return Measured(what, f"calibrate {command}", figures)
