"""What is to be calibrated by what: the images' views, what is known before, and what of the views still counts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wheelsight.calibration import Calibration
from wheelsight.camera_calibration.board import Board
from wheelsight.camera_calibration.settings import CameraCalibrationSettings
from wheelsight.camera_calibration.views import SENSORS, Corners, DepthCells, View, ViewSet
from wheelsight.errors import ConfigError
from wheelsight.geometry import FloatArray, PinholeCamera

_USUAL_SQUARE_M = 0.05  # until depth tells
_KINECT_FOCAL_PX, _STEPS_PER_PX = 586.0, 8


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """What is known of the cameras before.

    Attributes:
        sensor: how depth is measured, one of `views.SENSORS`; raw disparities are recognised by themselves.
        is_registered: whether depth has colour's pixels.
        on_plate: whether the board is a part of a larger flat plate, whose depth counts too.
        nominal: cameras to begin with: their lenses and T_color_depth.
        keeps_color: whether the nominal colour lens is right and stays.
    """

    sensor: str = "structured-light"
    is_registered: bool = False
    on_plate: bool = False
    nominal: Calibration | None = None
    keeps_color: bool = False

    @property
    def known_cameras(self) -> Calibration | None:
        """The nominal calibration where it has cameras."""
        return self.nominal if self.nominal is not None and self.nominal.color is not None else None


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """Views of a board by cameras of which something is known, and how to go about it."""

    seen: ViewSet
    board: Board
    setup: CameraSetup
    settings: CameraCalibrationSettings

    @property
    def squares(self) -> FloatArray:
        """The board's corners (N, 3), in squares."""
        return self.board.points_m / self.board.square_m

    @property
    def first_square_m(self) -> float:
        """The side of a square, or what is taken for it until depth tells."""
        return self.board.square_m if self.board.is_size_known else _USUAL_SQUARE_M

    @property
    def nominal_step(self) -> float:
        """Inverse depth, 1/m, by which one raw disparity more is farther away, as Kinect v1's maker has it."""
        return nominal_step(self.settings)

    def nominal_m(self, reading: FloatArray) -> FloatArray:
        """Readings as metres; raw disparities as the maker has them."""
        if not self.seen.is_disparity:
            return reading
        return np.asarray(
            1 / np.maximum(-self.nominal_step * (self.settings.model.disparity_of_infinity - reading), 1e-3)
        )

    def check(self) -> None:
        """Raise ConfigError for a setup that does not fit the images."""
        seen, setup, nominal = self.seen, self.setup, self.setup.known_cameras
        if setup.sensor not in SENSORS:
            raise ConfigError(f"--sensor {setup.sensor!r} is not known", fix=f"choose from {', '.join(SENSORS)}")
        if setup.is_registered and seen.depth_size not in (None, seen.color_size):
            sizes = " and ".join(told_size(size) for size in (seen.color_size, seen.depth_size) if size)
            raise ConfigError(f"--registered, but colour and depth images are {sizes}", fix="leave --registered out")
        if not self.board.is_size_known and not seen.has_depth:
            fix = "measure them: --board 9x6:25mm"
            raise ConfigError("without depth nothing tells the size of the squares", fix=fix)
        if nominal is None:
            if setup.keeps_color:
                problem = "--keep-color keeps the lens of a calibration, and none is given"
                raise ConfigError(problem, fix="add --calibration")
            return
        color, depth = nominal.cameras
        _check_size("colour", seen.color_size, color)
        if seen.depth_size is not None and not setup.is_registered:
            _check_size("depth", seen.depth_size, depth)


def nominal_step(settings: CameraCalibrationSettings) -> float:
    """Inverse depth, 1/m, of one raw disparity, as Kinect v1's maker has it: an eighth of a pixel."""
    return -1 / (_STEPS_PER_PX * _KINECT_FOCAL_PX * settings.model.baseline_m)


def told_size(size: tuple[int, int]) -> str:
    """Width × height, for messages."""
    return f"{size[0]}×{size[1]}"


def _check_size(name: str, size: tuple[int, int], camera: PinholeCamera) -> None:
    known = int(camera.width), int(camera.height)
    if size != known:
        problem = f"{name} images are {told_size(size)}, those of --calibration {told_size(known)}"
        raise ConfigError(problem, fix="give the calibration of this camera, or leave it out")


@dataclass(frozen=True, eq=False, slots=True)
class Counted:
    """What of the views counts: of each view its corners and depth cells; and what does not.

    Attributes:
        views: of the task, those that count.
        color, infrared, cells: of each of them.
        left_out: names of the others, and why.
        dropped_corners, dropped_cells: how many disagreed with their view.
    """

    views: tuple[View, ...]
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
        """The same without views, by their place and why."""
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
