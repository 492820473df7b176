"""CameraCalibrationSettings: what can be set about calibrating cameras by a board, with reasons for the defaults."""

from __future__ import annotations

from typing import Annotated

from wheelsight.core.settings import CHOSEN, Settings, bounds, setting

_SIMULATED = "found on simulated boards alone"
_BOARD = "Kinect v1's board of Herrera et al.'s kind, 21 views"


class DetectionSettings(Settings):
    """Which corners count."""

    enlarge_below_px: float = setting(
        1000.0,
        "images narrower than this are searched once more at twice their size where nothing was found: squares under "
        "10 px are missed",
        _BOARD,
        ge=0,
        le=1e5,
    )
    blurred_px: float = setting(
        4.5,
        "an edge between black and white that takes longer, 10 to 90 %, is blurred: corners are off by a tenth of it "
        "where it is unlike on both sides",
        CHOSEN,
        gt=0,
        le=100,
    )
    fewest_corners: int = setting(8, "of a board half out of view: fewer hold no pose", CHOSEN, ge=4, le=1000)
    sigma_px: float = setting(
        0.15,
        "of a corner, as an initial value",
        "OpenCV's sector-based detector on real boards has 0.1 to 0.2",
        gt=0,
        le=10,
    )
    least_sigma_px: float = setting(0.02, "and no less than this, of images without noise", CHOSEN, gt=0, le=1)


class DepthSampleSettings(Settings):
    """Which depth pixels count, and as what."""

    cell_px: int = setting(
        8,
        "pixels a side of which one reading is made, their mean: Kinect v1's noise is alike over some 3 px",
        "Konolige & Mihelich, technical description of Kinect calibration, 2011: 9 px of matching at most",
        ge=1,
        le=100,
    )
    fewest_cells: int = setting(12, "of a view: fewer hold no plane beside the board's pose", CHOSEN, ge=3, le=10000)
    most_cells: int = setting(400, "of a view: more add no information, as views do", CHOSEN, ge=10, le=100000)
    rim_px: int = setting(
        5,
        "of the plane's edge that is left out: flying pixels and ragged edges",
        "Nguyen et al. 2012: 0.8 px, thrice",
        ge=0,
        le=100,
    )
    same_plane: float = setting(
        0.02,
        "share of its distance that a pixel may be off the plane and be of it: distortion is 0.5 % and noise 0.5 %",
        _BOARD,
        gt=0,
        le=0.5,
    )
    sigma_disparity: float = setting(
        0.8, "of a raw disparity's cell, as an initial value", "Herrera et al. 2012, section 5", gt=0, le=100
    )
    sigma_share: float = setting(
        0.5, "noise of a cell's mean, as a share of a pixel's, as an initial value", CHOSEN, gt=0, le=10
    )


class PriorSettings(Settings):
    """What holds parameters that views say little of, as standard deviations."""

    radial: tuple[Annotated[float, bounds(gt=0, le=100)], ...] = setting(
        (0.3, 1.0, 1.5),
        "k1, k2, k3 about 0",
        "three times as wide as TUM's three Kinects: 0.26, -0.95, 1.16 at most",
        min_length=3,
        max_length=3,
    )
    tangential: float = setting(0.01, "p1, p2 about 0", "TUM's three Kinects: 0.006 at most", gt=0, le=1)
    aspect: float = setting(
        0.003, "fy / fx about 1", "TUM's three Kinects: 0.004 at most; iPi and libfreenect2's units: 0.001", gt=0, le=1
    )
    depth_focal: float = setting(
        0.02,
        "share by which a depth lens without infrared images is off its nominal focal length",
        "TUM's and Herrera et al.'s Kinects: 571 to 594 px about 586",
        gt=0,
        le=1,
    )
    depth_centre_px: float = setting(
        15.0, "of 640 px, likewise its centre", "published Kinects: 313 to 340 px across, 229 to 247 down", gt=0, le=500
    )
    apart_m: float = setting(0.1, "between the two cameras, about nothing", "no sensor is wider", gt=0, le=1)
    pattern_per_m: float = setting(
        0.01, "a knot of the pattern of inverse depth: 3.5 steps of Kinect v1's disparity", _BOARD, gt=0, le=1
    )
    pattern_bend_per_m: float = setting(0.004, "and its second difference to its neighbours", _BOARD, gt=0, le=1)
    tof_scale: float = setting(
        0.002,
        "of time of flight's scale about 1: its clock is a quartz, good to 1e-4, and boards' sizes are good to 0.2 % "
        "by a ruler; without it scale, offset and curve are one another's: any line can be moved between them",
        "computed",
        gt=0,
        le=1,
    )
    curve_m: float = setting(
        0.01, "a knot of the curve over distance", "Lachat et al. 2015: Kinect v2 swings by 7 mm", gt=0, le=1
    )
    curve_bend_m: float = setting(
        0.005, "and its second difference, at knots 0.25 m apart", "the same: 7 mm in waves of 1.9 m", gt=0, le=1
    )
    fade_m: float = setting(0.5, "of the pattern, about 0.5", "Herrera et al. 2012: exp(-0.0018 d)", gt=0, le=10)


class DepthModelSettings(Settings):
    """How fine a depth error may be."""

    pattern_columns: int = setting(
        8,
        "knots of the pattern across: Kinect v1's error is alike over 80 px",
        "wall of the same recording",
        ge=2,
        le=64,
    )
    pattern_rows: int = setting(6, "and down", "wall of the same recording", ge=2, le=64)
    curve_step_m: float = setting(
        0.25,
        "between knots over distance: Kinect v2's error swings once in 1.9 m",
        "Lachat et al. 2015",
        gt=0.01,
        le=10,
    )
    curve_from_m: float = setting(
        0.5,
        "where the curve begins, and where boards were nearer there: beyond the last board its knots are as sure as "
        "their prior is, and said to be",
        "Kinect v2's range by its maker: 0.5 to 4.5 m",
        ge=0,
        le=100,
    )
    curve_to_m: float = setting(4.5, "and where it ends", "the same", gt=0, le=100)
    stated_to_m: float = setting(
        4.0,
        "depth's σ is told up to there, boards or not: robots use what a depth camera shows so far",
        CHOSEN,
        gt=0,
        le=100,
    )
    baseline_m: float = setting(
        0.075,
        "Kinect v1's, as an initial value for raw disparities, and where the squares' size is not known",
        "Khoshelham & Elberink 2012",
        gt=0,
        le=1,
    )
    disparity_of_infinity: float = setting(
        1090.0,
        "likewise Kinect v1's raw disparity of what is infinitely far",
        "Konolige & Mihelich 2011",
        gt=0,
        le=2047,
    )


class RobustSettings(Settings):
    """What is left out."""

    corner_sigmas: float = setting(
        4.5, "a corner farther off than so many σ: one in 10⁵ by noise", "computed", gt=2, le=100
    )
    view_factor: float = setting(
        2.5,
        "a view whose corners' RMS is so many times the median view's is of a moved or bent board",
        _BOARD,
        gt=1,
        le=100,
    )
    cell_sigmas: float = setting(4.0, "a cell of depth farther off the plane than so many σ", "computed", gt=2, le=100)
    depth_view_factor: float = setting(
        4.0,
        "a view whose depth is so many times the median view's off: it moved between the images",
        CHOSEN,
        gt=1,
        le=100,
    )
    rounds: int = setting(
        3, "fits, with what disagrees left out between them", "no more is left out later", ge=1, le=20
    )


class RefusalSettings(Settings):
    """What does not determine a calibration."""

    fewest_views: int = setting(
        6, "three determine a lens (Zhang 2000), twice that shows what disagrees", CHOSEN, ge=3, le=1000
    )
    least_tilt_deg: float = setting(
        12.0,
        "between the most unlike boards: frontal ones tell focal length and distance apart by nothing",
        "Zhang 2000, fig. 6: errors grow steeply below 20° and are least at 45°",
        gt=0,
        le=90,
    )
    least_cover: float = setting(
        0.25,
        "share of the image's 8 × 6 cells that hold corners; a board only in the middle says nothing of the rest",
        _BOARD,
        gt=0,
        le=1,
    )
    least_distance_ratio: float = setting(
        1.3,
        "of the farthest board's distance to the nearest's: depth's scale and offset are told apart by no less",
        CHOSEN,
        gt=1,
        le=100,
    )
    focal_sigma: float = setting(0.01, "share of the focal length", CHOSEN, gt=0, le=1)
    centre_sigma_px: float = setting(10.0, "of the colour camera's centre, of an image of 640 px", CHOSEN, gt=0, le=500)
    apart_sigma_m: float = setting(0.015, "of where the cameras are to each other, each axis", CHOSEN, gt=0, le=1)
    apart_sigma_deg: float = setting(1.5, "likewise of turns", CHOSEN, gt=0, le=90)
    depth_sigma_m: float = setting(
        0.02, "of depth anywhere between the nearest and the farthest board", CHOSEN, gt=0, le=1
    )
    beyond_factor: float = setting(
        2.0,
        "σ of depth at the end of the reported range, over that at the farthest board, beyond which a warning says "
        "that boards are missing",
        CHOSEN,
        ge=1,
        le=1000,
    )
    largest_rms_px: float = setting(
        1.5, "of corners that are left: more is a board of another shape than told", CHOSEN, gt=0, le=100
    )


class CoachSettings(Settings):
    """Which views are asked for."""

    tilt_deg: float = setting(
        25.0, "to each of four sides", "Zhang 2000: errors are least about 45°, corners at 25°", gt=0, le=80
    )
    columns: int = setting(3, "parts of the image across that a board's corners should reach", CHOSEN, ge=1, le=20)
    rows: int = setting(3, "and down", CHOSEN, ge=1, le=20)
    near_far: float = setting(2.0, "farthest over nearest board", CHOSEN, gt=1, le=20)
    enough: int = setting(20, "views", _SIMULATED, ge=3, le=1000)
    still_share: float = setting(
        0.0015,
        "of the image's width by which half of the corners may move in a live view that is still: 1 px of 640, so that "
        "depth that cameras average over frames is of one place",
        CHOSEN,
        gt=0,
        le=0.1,
    )
    still_s: float = setting(0.4, "for so many seconds; cameras average depth over fewer", CHOSEN, gt=0, le=10)
    new_share: float = setting(
        0.02,
        "of the image's width by which some corner must lie elsewhere than in each live view before: what stays "
        "where it was tells nothing new",
        CHOSEN,
        gt=0,
        le=1,
    )
    more_views: int = setting(
        5,
        "live views after which calibrating is tried again where it was refused",
        CHOSEN,
        ge=1,
        le=1000,
    )


class CameraCalibrationSettings(Settings):
    """Of `wheelsight calibrate camera`."""

    detection: DetectionSettings = DetectionSettings()
    depth: DepthSampleSettings = DepthSampleSettings()
    model: DepthModelSettings = DepthModelSettings()
    prior: PriorSettings = PriorSettings()
    robust: RobustSettings = RobustSettings()
    refusal: RefusalSettings = RefusalSettings()
    coach: CoachSettings = CoachSettings()
