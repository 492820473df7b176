"""`CalibrationTask` states a calibration problem. `Model` holds its parameters, and `model_of` builds it from views
with initial values of lenses and poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from wheelsight.core.calibration import Calibration
from wheelsight.core.depth_errors import LARGEST_GRID, DepthError
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, IntArray, PinholeCamera, se3, so3
from wheelsight_calibration.board import Board
from wheelsight_calibration.views import RAW_DISPARITY, SENSORS, BoardView, Corners, DepthCells, ViewSet, size_text

_USUAL_SQUARE_M = 0.05  # initial value without known size
# Inverse depth, 1/m, of one raw disparity, nominally an eighth of a pixel for Kinect v1 with its baseline of 75 mm
# (Khoshelham & Elberink 2012), and the raw disparity of infinite distance (Konolige & Mihelich 2011).
NOMINAL_STEP, DISPARITY_OF_INFINITY = -1 / (8 * 586.0 * 0.075), 1090.0
# Rows and columns of knots of the pattern: Kinect v1's error is similar over 80 px.
_PATTERN_GRID = 6, 8
# Step of the knots of the curve over distance, whose error for Kinect v2 swings once in 1.9 m (Lachat et al. 2015), and
# its range: Kinect v2's by its maker, or that of the boards if larger.
_CURVE_STEP_M, _CURVE_FROM_M, _CURVE_TO_M = 0.25, 0.5, 4.5


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Prior knowledge of the cameras.

    Attributes:
        sensor: type of depth sensor, one of `views.SENSORS`; raw disparities are recognised automatically.
        is_registered: whether depth has the pixel grid of colour.
        on_plate: whether the board is a part of a larger flat plate, whose depth counts too.
        nominal: initial lenses and T_color_depth.
        keeps_color: whether the nominal colour lens is kept.
    """

    sensor: str = "structured-light"
    is_registered: bool = False
    on_plate: bool = False
    nominal: Calibration | None = None
    keeps_color: bool = False

    @property
    def known_cameras(self) -> Calibration | None:
        """The nominal calibration if it has cameras, else None."""
        return self.nominal if self.nominal is not None and self.nominal.color is not None else None


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationTask:
    """A calibration problem: views of a board, and prior knowledge of the cameras."""

    seen: ViewSet
    board: Board
    setup: CameraSetup

    @property
    def squares(self) -> FloatArray:
        """The board's corners (N, 3), in squares."""
        return self.board.points_m / self.board.square_m

    @property
    def first_square_m(self) -> float:
        """The side of a square, or an initial value if it is unknown."""
        return self.board.square_m if self.board.is_size_known else _USUAL_SQUARE_M

    def nominal_m(self, reading: FloatArray) -> FloatArray:
        """Readings in metres; raw disparities by the nominal model."""
        if not self.seen.is_disparity:
            return reading
        return np.asarray(1 / np.maximum(-NOMINAL_STEP * (DISPARITY_OF_INFINITY - reading), 1e-3))

    def check(self) -> None:
        """Raise ConfigError for a setup that does not fit the images."""
        seen, setup, nominal = self.seen, self.setup, self.setup.known_cameras
        if setup.sensor not in SENSORS:
            raise ConfigError(f"--sensor {setup.sensor!r} is not known", fix=f"choose from {', '.join(SENSORS)}")
        if setup.is_registered and seen.depth_size not in (None, seen.color_size):
            sizes = " and ".join(size_text(size) for size in (seen.color_size, seen.depth_size) if size)
            raise ConfigError(f"--registered, but colour and depth images are {sizes}", fix="leave --registered out")
        if not self.board.is_size_known and not seen.has_depth:
            fix = "measure them: --board 9x6:25mm"
            raise ConfigError("without depth the size of the squares is unknown", fix=fix)
        if nominal is None:
            if setup.keeps_color:
                problem = "--keep-color keeps the lens of a calibration, and none is given"
                raise ConfigError(problem, fix="add --calibration")
            return
        color, depth = nominal.cameras
        _check_size("colour", seen.color_size, color)
        if seen.depth_size is not None and not setup.is_registered:
            _check_size("depth", seen.depth_size, depth)


def _check_size(name: str, size: tuple[int, int], camera: PinholeCamera) -> None:
    known = int(camera.width), int(camera.height)
    if size != known:
        problem = f"{name} images are {size_text(size)}, those of --calibration {size_text(known)}"
        raise ConfigError(problem, fix="give the calibration of this camera, or leave it out")


@dataclass(frozen=True, eq=False, slots=True)
class Counted:
    """The views in use, with their corners and depth cells, and the removed ones.

    Attributes:
        views: the views in use.
        color, infrared, cells: corners and depth cells of each of these.
        left_out: names of removed views, with reasons.
        dropped_corners, dropped_cells: numbers of removed outliers.
    """

    views: tuple[BoardView, ...]
    color: tuple[Corners, ...]
    infrared: tuple[Corners | None, ...]
    cells: tuple[DepthCells, ...]
    left_out: tuple[tuple[str, str], ...] = field(default=())
    dropped_corners: int = 0
    dropped_cells: int = 0

    @classmethod
    def of(cls, seen: ViewSet) -> Counted:
        """All views, without depth cells."""
        views = seen.views
        color, infrared = tuple(view.color for view in views), tuple(view.infrared for view in views)
        return cls(views, color, infrared, tuple(DepthCells.none() for _ in views), seen.left_out)

    def without(self, gone: dict[int, str]) -> Counted:
        """The same without some views, given by index with the reason."""
        kept = [k for k in range(len(self.views)) if k not in gone]
        return Counted(
            tuple(self.views[k] for k in kept),
            tuple(self.color[k] for k in kept),
            tuple(self.infrared[k] for k in kept),
            tuple(self.cells[k] for k in kept),
            (*self.left_out, *((self.views[k].name, reason) for k, reason in gone.items())),
            self.dropped_corners,
            self.dropped_cells,
        )


# The cost is that of Herrera, Kannala & Heikkilä, "Joint depth and color camera calibration with distortion
# correction", TPAMI 34 (2012): corners in pixels and depth on the boards' planes, each over its standard deviation,
# and priors as further residuals.


_LENS, BARE_LENS, _POSE, BEFORE_KNOTS = 9, 4, 6, 3


class Points(NamedTuple):
    """Corners of all views, one after the other: view (N,), point on the board in squares (N, 3), pixel (N, 2)."""

    view: IntArray
    square: FloatArray
    px: FloatArray


class CellTable(NamedTuple):
    """Depth cells of all views: view (N,), pixel (N, 2), reading (N,), a pixel's scatter in it (N,)."""

    view: IntArray
    px: FloatArray
    reading: FloatArray
    scatter: FloatArray


class Sigmas(NamedTuple):
    """Standard deviations of corners in colour and infrared, pixels; of depth a factor on its noise model."""

    color_px: float
    infrared_px: float
    depth: float


@dataclass(frozen=True, eq=False)
class Model:
    """The parameters of a calibration and its measurements.

    Attributes:
        color, infrared, cells: measurements.
        color_start, depth_start: initial lenses; without infrared images the latter is a prior too.
        sensor: one of `SENSORS`, or `RAW_DISPARITY`.
        is_registered: whether depth has the pixel grid of colour.
        square_m: side of a square, or None if it is a parameter.
        noise: (constant_m, quadratic_per_m) of a cell, before `Sigmas.depth`.
        knots_m: distances (K,) of the knots of the depth curve, if there is one.
        T_color_depth: (4, 4) initial value.
        count: number of views.
        keeps_color: whether the colour lens is known and stays.
    """

    color: Points
    infrared: Points
    cells: CellTable
    color_start: PinholeCamera
    depth_start: PinholeCamera
    sensor: str
    is_registered: bool
    square_m: float | None
    noise: tuple[float, float]
    knots_m: FloatArray
    T_color_depth: FloatArray
    count: int
    keeps_color: bool = False

    def slices(self) -> dict[str, slice]:
        """Where in the vector of parameters each block stands; poses last."""
        error = BEFORE_KNOTS + 2 * _PATTERN_GRID[0] * _PATTERN_GRID[1]
        if self.sensor in ("tof", "stereo"):
            error = 3 + (len(self.knots_m) if self.sensor == "tof" else 0)
        sizes = {
            "color": _LENS,
            "depth": 0 if self.is_registered else _LENS if self.seeks_depth_distortion else BARE_LENS,
            "apart": 0 if self.is_registered else _POSE,
            "square": int(self.square_m is None),
            "error": error if len(self.cells.px) else 0,
            "poses": _POSE * self.count,
        }
        if not self.is_registered and not len(self.cells.px) and not len(self.infrared.px):
            sizes["depth"] = sizes["apart"] = 0
        ends = np.cumsum(list(sizes.values()))
        return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    @property
    def seeks_depth_distortion(self) -> bool:
        """Whether the distortion of the depth lens is a parameter; stereo's images are straightened in the camera.

        Tilted planes determine it without infrared images too: the ray of a displaced pixel meets a tilted plane nearer
        or farther. No lens is straight, nor is depth that a driver registers to a colour image.
        """
        return self.sensor != "stereo" or len(self.infrared.px) > 0

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of the pattern's knots."""
        return _PATTERN_GRID

    @property
    def has_pattern(self) -> bool:
        """Whether the depth error has a pattern over the image, as disparities have."""
        return self.sensor in ("structured-light", RAW_DISPARITY)

    def color_camera(self, x: FloatArray) -> PinholeCamera:
        """The colour camera of parameters."""
        return _lens(x[self.slices()["color"]], self.color_start)

    def depth_camera(self, x: FloatArray) -> PinholeCamera:
        """The depth camera of parameters."""
        if self.is_registered:
            return self.color_camera(x)
        p = x[self.slices()["depth"]]
        return _lens(p, self.depth_start) if len(p) else self.depth_start

    def T_color_depth_of(self, x: FloatArray) -> FloatArray:
        """(4, 4) of parameters."""
        p = x[self.slices()["apart"]]
        return se3.exp(p) @ self.T_color_depth if len(p) else self.T_color_depth

    def square_of(self, x: FloatArray) -> float:
        """Side of a square, metres."""
        p = x[self.slices()["square"]]
        return float(np.exp(p[0])) if self.square_m is None else self.square_m

    def poses_of(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rotations (count, 3, 3) and translations (count, 3), metres, from boards into the colour camera."""
        p = x[self.slices()["poses"]].reshape(-1, _POSE)
        return so3.exp(p[:, 3:]), p[:, :3] * self.square_of(x)

    def error_of(self, x: FloatArray) -> DepthError:
        """The depth error of parameters."""
        p = x[self.slices()["error"]]
        if not len(p):
            return DepthError()
        if self.sensor == "tof":
            knots_m, added_m = (finer(values, LARGEST_GRID).tolist() for values in (self.knots_m, p[3:]))
            curve = tuple(zip(knots_m, added_m, strict=True))
            return DepthError(float(np.exp(p[0])), float(p[1]), float(p[2]), curve_m=curve)
        if self.sensor == "stereo":
            return DepthError(float(np.exp(p[0])), radial_m=float(p[2]), inverse_per_m=float(p[1]))
        patterns = finer(finer(p[BEFORE_KNOTS:].reshape(2, *self.grid), LARGEST_GRID, 1), LARGEST_GRID, 2).tolist()
        pattern, lasting = (tuple(tuple(row) for row in rows) for rows in patterns)
        fade_m = float(np.clip(p[2], 0, 10))
        if self.sensor == RAW_DISPARITY:
            step = NOMINAL_STEP * float(np.exp(p[0]))
            at_zero = -NOMINAL_STEP * DISPARITY_OF_INFINITY + float(p[1])
            numbers: dict[str, Any] = {"disparity_at_zero_per_m": at_zero, "disparity_step_per_m": step}
        else:
            numbers = {"scale": float(np.exp(p[0])), "inverse_per_m": float(p[1])}
        return replace(DepthError(**numbers), fade_m=fade_m, pattern_per_m=pattern, lasting_per_m=lasting)

    @property
    def is_scale_free(self) -> bool:
        """Whether depth's scale is a parameter; for boards of unknown size the square is one instead."""
        return self.square_m is not None


def _lens(p: FloatArray, start: PinholeCamera) -> PinholeCamera:
    """A lens by ln(fx / start's), ln(fy / fx), centre relative to the image's middle over fx, and distortion."""
    fx = start.fx * float(np.exp(p[0]))
    cx, cy = (start.width - 1) / 2 + start.fx * p[2], (start.height - 1) / 2 + start.fx * p[3]
    k1, k2, p1, p2, k3 = p[4:] if len(p) > BARE_LENS else start.distortion
    centre = float(np.clip(cx, 0, start.width)), float(np.clip(cy, 0, start.height))
    return PinholeCamera(start.width, start.height, fx, fx * float(np.exp(p[1])), *centre, (k1, k2, p1, p2, k3))


def lens_parameters(camera: PinholeCamera, start: PinholeCamera, is_bare: bool = False) -> FloatArray:
    """The parameters of a lens relative to `start`."""
    centre = (camera.cx - (start.width - 1) / 2) / start.fx, (camera.cy - (start.height - 1) / 2) / start.fx
    bare = [np.log(camera.fx / start.fx), np.log(camera.fy / camera.fx), *centre]
    return np.array(bare if is_bare else [*bare, *camera.distortion], float)


# Noise of one pixel by how depth is measured: Khoshelham & Elberink 2012, Fankhauser et al. 2015, and of stereo 0.1 px
# of disparity with 50 mm between lenses of 640 px (Intel's tuning guide for D400 cameras).
_NOISE = {"structured-light": (0.001, 1.425e-3), "tof": (0.0015, 0.2e-3), "stereo": (0.001, 3.1e-3)}
_LEAST_NOISE_M = 1e-4
# Standard deviation of a raw disparity's cell (Herrera et al. 2012, section 5), and the noise of a cell's mean as a
# share of a pixel's, as initial values.
_SIGMA_DISPARITY, SIGMA_SHARE = 0.8, 0.5


def model_of(
    task: CalibrationTask, counted: Counted, lenses: tuple[PinholeCamera, PinholeCamera], T_color_depth: FloatArray
) -> Model:
    """The model of the views in use, with initial lenses of colour and depth and T_color_depth."""
    sensor = RAW_DISPARITY if task.seen.is_disparity else task.setup.sensor
    view = np.concatenate([np.full(len(c.reading), k) for k, c in enumerate(counted.cells)]).astype(np.int64)
    px, reading, scatter = (
        np.concatenate([getattr(c, name) for c in counted.cells]) for name in ("px", "reading", "scatter")
    )
    cells, nominal = CellTable(view, px, reading, scatter), task.setup.known_cameras
    if sensor == RAW_DISPARITY:  # noise of one pixel
        noise = _LEAST_NOISE_M, _SIGMA_DISPARITY / SIGMA_SHARE * -NOMINAL_STEP
    elif nominal is not None:
        noise = nominal.depth_noise.constant_m, nominal.depth_noise.quadratic_per_m
    else:
        noise = _NOISE[sensor]
    knots_m = np.empty(0)
    if sensor == "tof" and len(reading):  # from the sensor's nearest to its farthest, or as far as boards were
        low = min(_CURVE_FROM_M, float(np.percentile(reading, 1)))
        high = max(_CURVE_TO_M, float(np.percentile(reading, 99)))
        knots_m = np.linspace(low, high, min(max(int((high - low) / _CURVE_STEP_M) + 1, 2), LARGEST_GRID))
    return Model(
        color=_joined(counted.color, task.squares),
        infrared=_joined(counted.infrared, task.squares),
        cells=cells,
        color_start=lenses[0],
        depth_start=lenses[1],
        sensor=sensor,
        is_registered=task.setup.is_registered,
        square_m=task.board.square_m if task.board.is_size_known else None,
        noise=noise,
        knots_m=knots_m,
        T_color_depth=T_color_depth,
        count=len(counted.views),
        keeps_color=task.setup.keeps_color,
    )


def filled(
    model: Model, x: FloatArray, lenses: tuple[PinholeCamera, PinholeCamera], square_m: float, T: FloatArray
) -> FloatArray:
    """Parameters with these lenses, square and poses (V, 4, 4), metres; the rest is that of x."""
    at, y = model.slices(), x.copy()
    y[at["color"]] = lens_parameters(lenses[0], model.color_start)
    size = at["depth"].stop - at["depth"].start
    if size:
        y[at["depth"]] = lens_parameters(lenses[1], model.depth_start)[:size]
    if model.square_m is None:
        y[at["square"]] = np.log(square_m)
    y[at["poses"]] = np.concatenate([T[:, :3, 3] / square_m, so3.log(T[:, :3, :3])], axis=1).ravel()
    return y


def with_cells(
    task: CalibrationTask,
    counted: Counted,
    T_depth_board: FloatArray,
    depth: PinholeCamera,
    square_m: float,
    share: float,
) -> Counted:
    """The same with depth cells of each view, within `share` of the board's predicted outline.

    Args:
        task: how cells are chosen.
        counted: the views.
        T_depth_board: (V, 4, 4), metres.
        depth: the depth lens.
        square_m: side of a square.
        share: of the outline, about its middle; for a board on a plate, of the area that gives the plane.
    """
    columns, rows = task.board.columns, task.board.rows
    corners = np.array([[-1, -1, 0], [columns, -1, 0], [columns, rows, 0], [-1, rows, 0]], float)
    middle = corners.mean(axis=0)
    outline_m = square_m * (middle + share * (corners - middle))
    cells = []
    for view, T in zip(counted.views, T_depth_board, strict=True):
        p = se3.apply(T, outline_m)
        if view.reading is None or (p[:, 2] <= 0).any():
            cells.append(DepthCells.none())
            continue
        outline_px = depth.denormalise(p[:, :2] / p[:, 2:])
        how = {"is_disparity": task.seen.is_disparity, "on_plate": task.setup.on_plate}
        cells.append(board_cells(view.reading, outline_px, **how))
    return replace(counted, cells=tuple(cells), dropped_cells=0)


def _joined(corners: Sequence[Corners | None], squares: FloatArray) -> Points:
    seen = [(k, c) for k, c in enumerate(corners) if c is not None]
    if not seen:
        return Points(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 2)))
    view = np.concatenate([np.full(len(c.ids), k) for k, c in seen])
    return Points(view, np.concatenate([squares[c.ids] for _, c in seen]), np.concatenate([c.px for _, c in seen]))


_FLAGS = (
    cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)
# Focal length by width of depth cameras without calibration: Kinect v1's and v2's; others see about 60°.
_KNOWN_FOCAL = {(640, 480): 586.0, (512, 424): 365.5}
_USUAL_FOCAL = 0.87
_USUAL_COLOR_FOCAL = 0.85


class LensStart(NamedTuple):
    """A lens, and the poses (V, 4, 4) of boards before it, in squares."""

    camera: PinholeCamera
    T_camera_board: FloatArray


def lens_from_corners(corners: Sequence[Corners], board: Board, size: tuple[int, int]) -> LensStart:
    """A lens with one distortion parameter, and poses, from corners alone, as initial values.

    Raises:
        CalibrationError: OpenCV finds no lens.
    """
    squares = (board.points_m / board.square_m).astype(np.float32)
    focal = _USUAL_COLOR_FOCAL * size[0]
    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    points = [squares[seen.ids] for seen in corners]
    px = [seen.px.astype(np.float32).reshape(-1, 1, 2) for seen in corners]
    try:
        _, K, k, turns, ways = cv2.calibrateCamera(
            points, px, size, K, np.zeros(5), flags=_FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS
        )
    except cv2.error as error:
        raise CalibrationError("the corners give no lens", fix="take other views: tilted, near and far") from error
    k1, k2, p1, p2, k3 = np.ravel(k)[:5].tolist()
    try:
        camera = PinholeCamera(
            *size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), (k1, k2, p1, p2, k3)
        )
    except CalibrationError:
        camera = PinholeCamera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)
        return poses_in(camera, corners, board)
    T = se3.from_parts(so3.exp(np.reshape(turns, (-1, 3))), np.reshape(ways, (-1, 3)))
    return LensStart(camera, T)


def poses_in(camera: PinholeCamera, corners: Sequence[Corners], board: Board) -> LensStart:
    """Poses of boards, in squares, before a known lens."""
    squares, poses = board.points_m / board.square_m, []
    for seen in corners:
        xy = camera.normalise(seen.px)
        _, turn, way = cv2.solvePnP(squares[seen.ids], xy, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        poses.append(se3.from_parts(so3.exp(np.ravel(turn)), np.ravel(way)))
    return LensStart(camera, np.array(poses))


def usual_lens(size: tuple[int, int]) -> PinholeCamera:
    """A typical depth lens for an image size."""
    focal = _KNOWN_FOCAL.get(size, _USUAL_FOCAL * size[0])
    return PinholeCamera(*size, focal, focal, (size[0] - 1) / 2, (size[1] - 1) / 2)


def apart_by_poses(T_color_board: FloatArray, T_depth_board: FloatArray) -> FloatArray:
    """T_color_depth from poses (V, 4, 4) of boards in both cameras: median translation, mean rotation."""
    T = T_color_board @ se3.invert(T_depth_board)
    return se3.from_parts(so3.nearest(T[:, :3, :3].mean(axis=0)), np.median(T[:, :3, 3], axis=0))


def apart_by_planes(
    T_color_board: FloatArray, planes: FloatArray, prior_m: float, T_color_depth: FloatArray
) -> FloatArray:
    """T_color_depth from poses (V, 4, 4) of boards, metres, and planes (V, 4), n · p = h, in the depth camera.

    Rotation by Kabsch over normals. Translation by least squares, with that of `T_color_depth` as prior.
    """
    known = np.isfinite(planes).all(axis=1)
    if np.count_nonzero(known) < 3:
        return T_color_depth
    n_color = T_color_board[known, :3, 2]
    h_color = (n_color * T_color_board[known, :3, 3]).sum(axis=1)
    n_depth, h_depth = planes[known, :3], planes[known, 3]
    # Parallel normals do not constrain the rotation about them; the known rotation does.
    held = 0.3 * T_color_depth[:3, :3]
    R = so3.nearest(n_color.T @ n_depth + held)
    rows = np.concatenate([n_color, np.eye(3) * 0.02 / prior_m])
    values = np.concatenate([h_color - h_depth, T_color_depth[:3, 3] * 0.02 / prior_m])
    return se3.from_parts(R, np.linalg.lstsq(rows, values, rcond=None)[0])


def plane_of(cells: DepthCells, depth_m: FloatArray, camera: PinholeCamera) -> FloatArray:
    """The plane (4,) n · p = h, h positive, of cells at depths (N,); NaN if there are too few."""
    kept = np.isfinite(depth_m) & (depth_m > 0)
    if np.count_nonzero(kept) < 3:
        return np.full(4, np.nan)
    rays = np.concatenate([camera.normalise(cells.px[kept]), np.ones((np.count_nonzero(kept), 1))], axis=1)
    m = np.linalg.lstsq(rays, 1 / depth_m[kept], rcond=None)[0]
    h = 1 / float(np.linalg.norm(m))
    return np.append(m * h, h)


_FIT_ROUNDS, _FEWEST_PX = 4, 50
# Side of a cell in pixels, whose mean is one reading: Kinect v1 matches over at most 9 px (Konolige & Mihelich 2011).
# The fewest cells of a view to determine a plane, and the most, since more add no information. Chosen.
_CELL_PX, _FEWEST_CELLS, _MOST_CELLS = 8, 12, 400
_RIM_PX = 5  # of the plane's edge, which is left out: flying pixels and ragged edges (Nguyen et al. 2012: 0.8 px)
# Largest distance of a pixel from its plane as a share of depth: distortion is 0.5 %, and noise 0.5 % (Kinect v1's
# board of Herrera et al.).
_SAME_PLANE = 0.02
_NOISE_SIGMAS = 4.5  # of a pixel's: one in 10⁵ is lost
_MOST_OF_CELL = 0.8


def board_cells(reading: Float32Array, outline_px: FloatArray, *, is_disparity: bool, on_plate: bool) -> DepthCells:
    """CellTable of the plane that a board is on, of one depth image.

    Args:
        reading: (H, W) depths in metres or raw disparities; 0 where unknown.
        outline_px: (N, 2) of an area within the board, in depth pixels.
        is_disparity: whether readings are raw disparities.
        on_plate: whether the plane continues around the outline; else cells stay within it.
    """
    seen = np.isfinite(reading) & (reading > 0)
    within = np.zeros(reading.shape, np.uint8)
    cv2.fillConvexPoly(within, cv2.convexHull(outline_px.astype(np.float32)).astype(np.int32), 1)
    plane = _plane(reading, seen, seen & (within > 0), is_disparity)
    if plane is None:
        return DepthCells.none()
    on_plane, off = plane
    kept = on_plane & (within > 0)
    if on_plate:  # the connected part of the plane with most of the outline
        _, labels = cv2.connectedComponents(on_plane.astype(np.uint8), connectivity=4)
        kept = np.asarray(labels == np.bincount(labels[kept]).argmax()) if kept.any() else kept
    rim = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * _RIM_PX + 1,) * 2)
    # The rim is left out beside holes too, because the object that shades them is not on the plane.
    closed = cv2.morphologyEx(kept.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    whole = cv2.erode(closed, rim, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    cells = _cells(reading, off, whole & on_plane)
    if len(cells.reading) < _FEWEST_CELLS:
        return DepthCells.none()
    if len(cells.reading) > _MOST_CELLS:
        cells = cells.only(np.linspace(0, len(cells.reading) - 1, _MOST_CELLS).round().astype(np.int64))
    return cells


def _plane(
    reading: Float32Array, seen: BoolArray, seed: BoolArray, is_disparity: bool
) -> tuple[BoolArray, FloatArray] | None:
    """Whether a pixel (H, W) lies on the plane of most of the seed, and its distance; None if the seed is too small.

    The distance is in inverse depth or raw disparity.
    """
    if np.count_nonzero(seed) < _FEWEST_PX:
        return None
    v, u = np.nonzero(seed)
    # Disparity and inverse depth of a plane are linear in the pixel.
    inverse = reading if is_disparity else np.divide(1, reading, out=np.zeros_like(reading), where=seen)
    values, A = inverse[v, u].astype(float), np.stack([u, v, np.ones(len(u))], axis=-1)
    kept = np.abs(values - np.median(values)) <= 3 * max(float(np.subtract(*np.percentile(values, (75, 25)))), 1e-6)
    plane = np.zeros(3)
    for _ in range(_FIT_ROUNDS):
        plane = np.linalg.lstsq(A[kept], values[kept], rcond=None)[0]
        off = np.abs(values - A @ plane)
        kept = off <= max(3 * 1.48 * float(np.median(off[kept])), 1e-9)
        if np.count_nonzero(kept) < _FEWEST_PX:
            return None
    height, width = reading.shape
    expected = plane[0] * np.arange(width) + plane[1] * np.arange(height)[:, None] + plane[2]
    # Kinect's raw disparities fall to 0 inverse depth at about 1090: a share of the depth is one of 1090 - d.
    least = _SAME_PLANE * (np.abs(1090.0 - expected) if is_disparity else np.abs(expected))
    least = np.maximum(least, _NOISE_SIGMAS * 1.48 * float(np.median(np.abs(values - A @ plane)[kept])))
    return np.asarray(seen & (np.abs(inverse - expected) <= least)), np.asarray(inverse - expected, float)


def _cells(reading: Float32Array, off: FloatArray, kept: BoolArray) -> DepthCells:
    """Means of the square cells whose pixels are mostly kept."""
    side = _CELL_PX
    rows, columns = (length // side for length in reading.shape)
    tiles = (slice(0, rows * side), slice(0, columns * side))
    v, u = np.mgrid[0 : reading.shape[0], 0 : reading.shape[1]]

    def sums(values: FloatArray) -> FloatArray:
        return np.asarray(values[tiles].reshape(rows, side, columns, side).sum(axis=(1, 3)), float)

    counts = sums(kept.astype(float))
    full = counts >= _MOST_OF_CELL * side**2
    # Where pixels are missing, the mean pixel is not the cell's middle.
    values = (u, v, reading, off, off**2)
    means = [sums(np.where(kept, value, 0.0))[full] / counts[full] for value in values]
    scatter = np.sqrt(np.maximum(means[4] - means[3] ** 2, 0))
    return DepthCells(np.stack(means[:2], axis=-1), means[2], scatter)


# Natural cubic splines as weights of their knots' values; files hold straight pieces.


_PIECES = 3


def cubic_weights(at: FloatArray, knots: FloatArray, derivative: int = 0) -> FloatArray:
    """The weight (N, K) of the value at each of the knots (K,), two or more, at points (N,); constant beyond the ends.

    `derivative` is its order.
    """
    spline = CubicSpline(knots, np.eye(len(knots)), bc_type="natural")
    inside = (at >= knots[0]) & (at <= knots[-1])
    found = np.asarray(spline(np.clip(at, knots[0], knots[-1]), derivative), float)
    return np.where(inside[:, None], found, 0.0) if derivative else found


def cubic_grid_weights(px: FloatArray, camera: PinholeCamera, grid: tuple[int, int]) -> FloatArray:
    """The weight (N, rows · columns) of each knot of a grid over the image at pixels (N, 2)."""
    down = cubic_weights(px[:, 1] / max(camera.height - 1, 1), np.linspace(0, 1, grid[0]))
    across = cubic_weights(px[:, 0] / max(camera.width - 1, 1), np.linspace(0, 1, grid[1]))
    return (down[:, :, None] * across[:, None, :]).reshape(len(px), -1)


def finer(values: FloatArray, most: int, axis: int = 0) -> FloatArray:
    """Values at evenly spread knots along an axis, and up to two between them: straight pieces in place of the spline.

    At most `most` values, but all knots. Three pieces have a ninth of the error of one.
    """
    count = values.shape[axis]
    pieces = max(min(_PIECES, (most - 1) // (count - 1)), 1)
    weights = cubic_weights(np.linspace(0, count - 1, pieces * (count - 1) + 1), np.arange(count, dtype=float))
    return np.moveaxis(np.tensordot(weights, values, axes=(1, axis)), 0, axis)
