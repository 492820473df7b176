"""`DenseSettings` configures dense odometry, with one part for each decision."""

from __future__ import annotations

from typing import Annotated, Literal

from wheelsight.core.settings import ASKED, CHOSEN, ON_SIMULATOR, Settings, bounds, setting

_FROM_0024 = f"{ON_SIMULATOR}: docs/decisions/0024"
_FROM_0025 = f"{ON_SIMULATOR}: docs/decisions/0025"
_FROM_0032 = f"{ON_SIMULATOR}: docs/decisions/0032"
_FROM_0034 = f"{ON_SIMULATOR}: docs/decisions/0034"
_FROM_0048 = "two real recordings of one Kinect: docs/decisions/0048"


class StartSettings(Settings):
    """The choice of initial guesses of alignment, and of its results."""

    turn_misfit: float = setting(
        3.0,
        "a rotation by grey is rejected if points then lie this many times as far from planes; depth and colour of a "
        "frame are rarely simultaneous, so grey may be right where planes fit worse",
        "real recordings",
        ge=1,
        le=100,
    )
    unpaired_sigmas: float = setting(
        5.0, "distance in standard deviations of a point without a plane nearby", CHOSEN, gt=0, le=100
    )
    clearly_nearer: float = setting(
        1.5,
        "another initial guess than the first is used if points lie this many times nearer to planes",
        _FROM_0034,
        ge=1,
        le=100,
    )
    as_many_planes: float = setting(
        0.7,
        "share of the first outcome's planes that another must find for grey to decide between both",
        _FROM_0034,
        gt=0,
        le=1,
    )
    as_near_planes: float = setting(
        1.1, "the largest residual of the other, as a multiple of the first one's", _FROM_0034, ge=1, le=100
    )
    clearer_grey: float = setting(
        0.85, "the other is taken if its grey residuals spread by less than this share", _FROM_0034, gt=0, le=1
    )


class FaultSettings(Settings):
    """Which poses by surfaces need verification by keypoints."""

    leap_m_s: float = setting(
        0.5, "metres a second that the camera may gain at once; more is a leap", CHOSEN, gt=0, le=100
    )
    leap_m_s2: float = setting(10.0, "and that much more for each second since the frame before", CHOSEN, ge=0, le=1000)
    leap_rad_s: float = setting(
        1.5, "radians a second that it may gain at once; hand-held cameras gain less", CHOSEN, gt=0, le=100
    )
    leap_rad_s2: float = setting(
        30.0, "and that much more for each second since the frame before", CHOSEN, ge=0, le=1000
    )
    off_prior_m_s: float = setting(
        0.2,
        "metres a second off a motion handed in: more than wheels err that do not slip (2 % of the radius at 1 m/s"
        " is a tenth of it)",
        _FROM_0024,
        gt=0,
        le=100,
    )
    off_prior_rad_s: float = setting(
        0.2, "radians a second likewise (3 % of the track at 90 degrees/s is a quarter of it)", _FROM_0024, gt=0, le=100
    )
    bridged_s: float = setting(
        10.0,
        "seconds of a gap that a motion handed in bridges; wheels are no farther off then than the next two say",
        _FROM_0025,
        ge=0,
        le=3600,
    )
    bridged_off_m: float = setting(
        0.05, "metres off that motion at which a pose after a gap needs no keypoints", _FROM_0025, gt=0, le=10
    )
    bridged_off_rad: float = setting(0.03, "and radians", _FROM_0025, gt=0, le=3.2)
    poor_fit: float = setting(
        2.0,
        "residuals this many times the usual one need verification, if there is no prior; wrong poses "
        "had 4 to 5 times (eight simulated flats); on a real hand-held recording that much is usual, and learned",
        "eight simulated flats, and one real hand-held recording: docs/decisions/0024",
        ge=1,
        le=100,
    )
    fit_learned: float = setting(
        0.1, "of a frame's residual that goes into what is usual, so within ten frames", CHOSEN, gt=0, le=1
    )


class VerificationSettings(Settings):
    """When poses by keypoints and by surfaces agree, and which of both counts."""

    keypoints: int = setting(
        1000,
        "of a frame, as feature odometry takes them; with 500 a frame is done 3 ms sooner and as accurate, but turns "
        "of 18 degrees from frame to frame are lost",
        _FROM_0048,
        ge=50,
        le=20_000,
    )
    agree_m: float = setting(
        0.04, "metres between both poses that still are the same: keypoints err by 1 to 2 cm", CHOSEN, gt=0, le=10
    )
    agree_rad: float = setting(0.035, "radians likewise, 2 degrees", CHOSEN, gt=0, le=3.2)
    agree_chi2: float = setting(
        16.8,
        "how sure they may be then at most: chi² of 6, 99 %, by their own covariance",
        "computed: χ² of 6",
        gt=0,
        le=1e6,
    )
    correlation: float = setting(
        20.0,
        "how many neighbouring keypoints err as one, as pixels do, where they are weighed against surfaces",
        _FROM_0048,
        gt=0,
        le=1e6,
    )
    clear_inliers: int = setting(
        60, "keypoints that must agree for them to count against surfaces", CHOSEN, gt=0, le=100_000
    )
    clear_share: float = setting(
        0.6, "and what share of those matched: in crowds and in places that look alike less", CHOSEN, gt=0, le=1
    )
    likely_share: float = setting(
        0.5,
        "of those matched that agree where a place was seen before: 63 to 96 % at the right place, 19 to 26 % in "
        "another stretch of the corridor",
        _FROM_0025,
        gt=0,
        le=1,
    )
    anywhere_s: float = setting(
        2.0,
        "seconds without a pose, and alone, after which the camera may be anywhere, so that `likely_share` is "
        "needed; after one second the right place in a corridor is recognised by less",
        _FROM_0025,
        ge=0,
        le=3600,
    )


class JointSettings(Settings):
    """The weight of surfaces relative to keypoints."""

    first_factor: float = setting(
        1.0,
        "on the covariance that surfaces claim, before anything is seen of the camera",
        CHOSEN,
        ge=1,
        le=1e6,
    )
    learned: float = setting(
        0.1, "of what a frame says of that factor's logarithm, so within ten frames", CHOSEN, gt=0, le=1
    )
    odd_chi2: float = setting(
        22.5,
        "beyond which keypoints and surfaces of a frame differ by more than is known by then, so that the frame's own "
        "factor counts: chi² of 6, 99.9 %; a quick turn parts colour and depth that are not of one instant",
        "computed: χ² of 6",
        gt=0,
        le=1e6,
    )
    shown: float = setting(
        1.0,
        "times the information of keypoints that surfaces must claim along a direction to be judged by it",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    most: float = setting(1e4, "a larger factor says no more than that", CHOSEN, gt=0, le=1e9)


class RegionSettings(Settings):
    """Which regions of a view move and are excluded."""

    columns: int = setting(8, "regions across the view; 0 asks for none", CHOSEN, ge=0, le=64)
    rows: int = setting(6, "and down", CHOSEN, ge=1, le=64)
    odd_factor: float = setting(
        2.5,
        "times as far from known surfaces as the median region, from which one moves by itself",
        CHOSEN,
        ge=1,
        le=100,
    )
    odd_sigmas: float = setting(3.0, "and at least this many standard deviations of depth", CHOSEN, gt=0, le=100)
    most_sigmas: float = setting(8.0, "more of one point counts as no more than that", CHOSEN, gt=0, le=100)
    gate: float = setting(
        0.03, "metres a metre of depth beyond which a point is on another surface", CHOSEN, ge=0, le=1
    )
    most_share: float = setting(
        0.4, "of the regions; where more would be left out, it is the pose that is wrong", CHOSEN, gt=0, le=1
    )
    min_points: int = setting(20, "of a region at the coarsest level for it to have a say", CHOSEN, gt=0, le=10_000)
    min_regions: int = setting(12, "that must have a say for any to be left out", CHOSEN, gt=0, le=4096)


class DelaySettings(Settings):
    """The estimation of the delay between colour and depth, beyond their stamps."""

    sigma_s: float = setting(
        0.015, "how far off the calibration's delay may be, a Kinect's; 0 learns nothing", _FROM_0048, ge=0, le=1
    )
    walk_s: float = setting(0.0002, "by which the delay may change from frame to frame", CHOSEN, ge=0, le=1)
    turn_sigma_rad: float = setting(
        0.02,
        "standard deviation of the difference between both rotations of a frame for other reasons",
        CHOSEN,
        gt=0,
        le=3,
    )
    clear_sigmas: float = setting(
        1.0, "standard deviations that a delay must differ by to be used", CHOSEN, gt=0, le=100
    )
    least_rad_s: float = setting(0.2, "a slower rotation gives no measurement of the delay", CHOSEN, gt=0, le=10)
    most_rad: float = setting(0.15, "a larger difference is no delay", CHOSEN, gt=0, le=3)
    most_s: float = setting(0.05, "a longer delay is none: one frame and a half", CHOSEN, gt=0, le=1)


class KeyframeSettings(Settings):
    """Poses of keyframes, and the tolerance of their rolling-shutter correction."""

    fineness: float = setting(
        0.8,
        "of a frame's resolution, what a keyframe must have to show it: along a corridor a frame is 3 mm off at "
        "half of it, 1 mm at this, and keypoints are recognised",
        _FROM_0032,
        gt=0,
        le=1,
    )
    kept_straight_px: float = setting(
        0.3, "pixels that rows of a keyframe may be off before it is straightened again", CHOSEN, ge=0, le=100
    )
    straight_px: float = setting(1.0, "and rows of a frame that is no keyframe: it costs 2 ms", CHOSEN, ge=0, le=100)
    short_motions: float = setting(
        2.0,
        "times that the covariance of the motion from the last keyframe counts beside that from the one before: "
        "where the two are against each other was found by a motion like it",
        CHOSEN,
        gt=0,
        le=100,
    )
    joined_chi2: float = setting(
        22.5, "how far apart both may be to say the same: chi² of 6, 99.9 %", "computed: χ² of 6", gt=0, le=1e6
    )
    tied_views: int = setting(
        5,
        "number of recent keyframes; older keyframes return if a loop closure ties one of these to another visit. The "
        "newest is not verified yet, and not every one is recognised",
        CHOSEN,
        ge=1,
        le=1000,
    )


class VignettingSettings(Settings):
    """The prior of vignetting, and the pixels that update it."""

    sigma: float = setting(
        0.3,
        "standard deviation of the exponent of cos⁴ before anything is seen: 0.22 for the simulated camera, 0.10 "
        "and 0.06 for two real ones",
        "one simulated camera and two real ones: docs/decisions/0029",
        gt=0,
        le=10,
    )
    max_exponent: float = setting(1.0, "beyond which no lens goes: cos⁴ itself", "cos⁴, the law of lenses", ge=0, le=10)
    uneven: float = setting(0.01, "standard deviation of log grey of a place from view to view", CHOSEN, gt=0, le=10)
    correlation: float = setting(20.0, "how many neighbouring pixels err as one", CHOSEN, gt=0, le=1e6)
    min_pixels: int = setting(300, "compared pixels below which nothing is learned", CHOSEN, gt=0, le=1_000_000)
    darkest: float = setting(20.0, "grey below this is noise", CHOSEN, ge=0, le=255)
    brightest: float = setting(235.0, "grey above this may be cut off", CHOSEN, gt=0, le=255)


_FROM_0028 = f"{ON_SIMULATOR}: docs/decisions/0028"
_FROM_0035 = f"{ON_SIMULATOR}: docs/decisions/0035"


class DenseSettings(Settings):
    """Settings of dense odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = setting(
        "keyframes", "what a frame is aligned with where no map predicts the view", ASKED
    )
    finest_width_px: int = setting(400, "images wider than this are halved until they are not", CHOSEN, ge=16, le=8192)
    levels: int = setting(3, "of the pyramid, each half as wide", CHOSEN, ge=1, le=5)
    iterations: tuple[Annotated[int, bounds(gt=0, le=1000)], ...] = setting(
        (4, 6, 8), "at most, from the finest level to the coarsest", CHOSEN, min_length=1, max_length=10
    )
    row_stride: int = setting(2, "stride of the aligned rows at the finest level", CHOSEN, gt=0, le=64)
    color_weight: float = setting(0.7, "of grey values against depth; 0 aligns depth alone", CHOSEN, ge=0, le=100)
    min_gradient: float = setting(
        3.0,
        "grey levels a pixel, at the second level; a flatter place may show nothing but noise",
        CHOSEN,
        ge=0,
        le=255,
    )
    gate: float = setting(0.06, "metres, and a metre of depth, beyond which points are no pair", CHOSEN, gt=0, le=10)
    huber: float = setting(1.5, "standard deviations beyond which a residual counts linearly", CHOSEN, gt=0, le=100)
    depth_jump: float = setting(0.03, "share of depth that separates two surfaces", CHOSEN, gt=0, le=1)
    depth_jump_sigmas: float = setting(
        4.2,
        "standard deviations of depth by which neighbours on one surface differ, beside that share: √2 times "
        "three; a limit that noise reaches picks neighbours that err alike",
        "computed; docs/decisions/0027",
        ge=0,
        le=100,
    )
    crease_sigmas: float = setting(
        2.0,
        "standard deviations of depth that a surface may be bent by to show a motion: at creases a fitted plane is"
        " no plane of the scene",
        CHOSEN,
        gt=0,
        le=1e6,
    )
    occlusion_share: float = setting(
        0.02,
        "share of a depth by which what is nearer within two pixels makes an occlusion boundary, whose grey moves "
        "as what is nearer does; on a corridor without noise ways were 0.09 % too long, 0.01 % since",
        _FROM_0028,
        ge=0,
        le=1,
    )
    occlusion_sigmas: float = setting(
        3.0,
        "and at least this many standard deviations of depth, because noise selects pixels by chance",
        CHOSEN,
        ge=0,
        le=100,
    )
    normal_radius_px: int = setting(2, "half width of the window a normal is fitted to", CHOSEN, ge=1, le=6)
    keyframe_overlap: float = setting(0.75, "of a keyframe; with less in sight a new one is made", CHOSEN, gt=0, lt=1)
    keyframe_way_m: float = setting(
        0.3,
        "beside a map: way from the nearest keyframe to a new one, a turn by a radian as 1.5 m",
        CHOSEN,
        gt=0,
        le=100,
    )
    predicted_way_m: float = setting(
        0.04,
        "a map's prediction serves while the camera is no farther away, a turn by a radian as 1.5 m",
        "docs/decisions/0039",
        ge=0,
        le=100,
    )
    predicted_frames: int = setting(
        3, "largest number of frames that use one prediction", "docs/decisions/0039", gt=0, le=1000
    )
    min_overlap: float = setting(0.25, "share of a frame's points that must find a partner", CHOSEN, gt=0, lt=1)
    max_residual: float = setting(
        5.0, "mean residual in standard deviations of the sensor's noise beyond which none fits", CHOSEN, gt=0, le=1000
    )
    degenerate_sigma_m: float = setting(
        0.01, "a direction less certain than this after one frame is left to the prior", CHOSEN, gt=0, le=10
    )
    confirmed_share: float = setting(
        0.4,
        "of what a reference shows of a direction, the share that the frame must show too: where both lie on each "
        "other, slopes of grey are alike; where an alignment has slipped along a wall, they are not",
        ON_SIMULATOR,
        ge=0,
        le=1,
    )
    other_prior_share: float = setting(
        0.5,
        "another motion than the one expected first fills unseen directions where it is off what is seen by less "
        "than this share",
        ON_SIMULATOR,
        gt=0,
        le=1,
    )
    color_error_left: float = setting(
        0.25,
        "of `color_sigma_px`, what is left between two images of a colour camera that is off alike in both",
        CHOSEN,
        ge=0,
        le=1,
    )
    correlation: float = setting(
        20.0, "how many neighbouring residuals err as one; variances are that much larger", CHOSEN, gt=0, le=1e6
    )
    prior_sigma_m_s: float = setting(
        0.5,
        "how far off the expected speed may be, a second; what unseen directions are worth",
        _FROM_0035,
        gt=0,
        le=100,
    )
    nonholonomic_share: float = setting(
        0.15, "of that, how far a base on wheels may go sideways, rise or tilt instead", _FROM_0035, gt=0, le=1
    )
    min_depth_share: float = setting(0.05, "of a frame's pixels that must have depth", CHOSEN, gt=0, lt=1)
    dark_grey: float = setting(
        12.0, "grey that is left in the dark, which is noise", "real Kinects, lens covered", ge=0, le=255
    )
    dark_share: float = setting(
        0.01, "an image is dark where fewer of its pixels than this are brighter than that", CHOSEN, ge=0, le=1
    )
    kept_keyframes: int = setting(
        60,
        "held in memory as views; those used longest ago go first, and come back where the camera does",
        CHOSEN,
        gt=0,
        le=10_000,
    )
    max_unseen_s: float = setting(
        0.5,
        "how long a direction of motion may stay unconstrained without another sensor",
        CHOSEN,
        gt=0,
        le=3600,
    )
    max_speed_m_s: float = setting(3.0, "a faster motion is implausible", CHOSEN, gt=0, le=100)
    max_turn_rad_s: float = setting(8.0, "a faster turn is implausible", CHOSEN, gt=0, le=100)
    lost_after: int = setting(
        10,
        "failed frames in a row, after which the state is lost",
        "Zhang, Fig. 3, N; the paper names no figure",
        gt=0,
        le=1_000_000,
    )
    threads: int = setting(2, "that share a frame's rows", "two cores, for which wheelsight is made", gt=0, le=64)
    starts: StartSettings = StartSettings()
    faults: FaultSettings = FaultSettings()
    delay: DelaySettings = DelaySettings()
    joint: JointSettings = JointSettings()
    regions: RegionSettings = RegionSettings()
    verification: VerificationSettings = VerificationSettings()
    keyframes: KeyframeSettings = KeyframeSettings()
    vignetting: VignettingSettings = VignettingSettings()
