"""DenseSettings: what can be set about dense odometry, with the reasons for the defaults."""

from __future__ import annotations

from typing import Annotated, Literal

from wheelsight.odometry.dense.settings_parts import (
    DelaySettings,
    FaultSettings,
    JointSettings,
    KeyframeSettings,
    RegionSettings,
    StartSettings,
    VerificationSettings,
    VignettingSettings,
)
from wheelsight.settings import ASKED, CHOSEN, ON_SIMULATOR, Settings, bounds, setting

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
    row_stride: int = setting(2, "of the finest level's rows only every so many are aligned", CHOSEN, gt=0, le=64)
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
    depth_jump: float = setting(0.03, "share of a depth that tells two surfaces apart", CHOSEN, gt=0, le=1)
    depth_jump_sigmas: float = setting(
        4.2,
        "standard deviations of depth by which neighbours on one surface differ, beside that share: √2 times "
        "three; a limit that noise reaches picks neighbours that err alike",
        "reckoned; docs/decisions/0027",
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
        3.0, "and so many standard deviations of depth, which would pick pixels by chance", CHOSEN, ge=0, le=100
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
        3, "at most so many frames that one prediction serves", "docs/decisions/0039", gt=0, le=1000
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
        "how long a direction of motion may stay unseen where nothing but the camera tells it",
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
