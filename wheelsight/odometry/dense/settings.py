"""DenseSettings: what can be set about dense odometry, with the reasons for the defaults."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from wheelsight.odometry.dense.settings_parts import (
    DelaySettings,
    FaultSettings,
    JointSettings,
    KeyframeSettings,
    StartSettings,
    VerificationSettings,
    VignettingSettings,
)
from wheelsight.settings import Settings


class DenseSettings(Settings):
    """Settings of dense odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = Field(
        default="keyframes", description="what a frame is aligned with where no map predicts the view"
    )
    finest_width_px: PositiveInt = Field(
        default=400, ge=16, le=8192, description="images wider than this are halved until they are not"
    )
    levels: int = Field(default=3, ge=1, le=5, description="of the pyramid, each half as wide")
    iterations: tuple[Annotated[PositiveInt, Field(le=1000)], ...] = Field(
        default=(4, 6, 8), min_length=1, max_length=5, description="at most, from the finest level to the coarsest"
    )
    row_stride: PositiveInt = Field(
        default=2, le=64, description="of the finest level's rows only every so many are aligned"
    )
    color_weight: NonNegativeFloat = Field(
        default=0.7, le=100, description="of grey values against depth; 0 aligns depth alone"
    )
    min_gradient: NonNegativeFloat = Field(
        default=3.0,
        le=255,
        description="grey levels a pixel, at the second level; a flatter place may show nothing but noise",
    )
    gate: PositiveFloat = Field(
        default=0.06, le=10, description="metres, and a metre of depth, beyond which points are no pair"
    )
    huber: PositiveFloat = Field(
        default=1.5, le=100, description="standard deviations beyond which a residual counts linearly"
    )
    depth_jump: PositiveFloat = Field(default=0.03, le=1, description="share of a depth that tells two surfaces apart")
    depth_jump_sigmas: NonNegativeFloat = Field(
        default=4.2,
        le=100,
        description="standard deviations of depth by which neighbours on one surface differ, beside that share: √2 "
        "times three; a limit that noise reaches picks neighbours that err alike",
    )
    crease_sigmas: PositiveFloat = Field(
        default=2.0,
        le=1e6,
        description="standard deviations of depth that a surface may be bent by to show a motion: at creases a fitted "
        "plane is no plane of the scene",
    )
    occlusion_share: NonNegativeFloat = Field(
        default=0.02,
        le=1,
        description="share of a depth by which what is nearer within two pixels makes an occlusion boundary, whose "
        "grey moves as what is nearer does; on a corridor without noise ways were 0.09 % too long, 0.01 % since",
    )
    occlusion_sigmas: NonNegativeFloat = Field(
        default=3.0, le=100, description="and so many standard deviations of depth, which would pick pixels by chance"
    )
    normal_radius_px: int = Field(default=2, ge=1, le=6, description="half width of the window a normal is fitted to")
    keyframe_overlap: float = Field(
        default=0.75, gt=0, lt=1, description="of a keyframe; with less in sight a new one is made"
    )
    keyframe_way_m: PositiveFloat = Field(
        default=0.3,
        le=100,
        description="beside a map: way from the nearest keyframe to a new one, a turn by a radian as 1.5 m",
    )
    predicted_way_m: NonNegativeFloat = Field(
        default=0.04,
        le=100,
        description="a map's prediction serves while the camera is no farther away, a turn by a radian as 1.5 m",
    )
    predicted_frames: PositiveInt = Field(
        default=3, le=1000, description="at most so many frames that one prediction serves"
    )
    min_overlap: float = Field(
        default=0.25, gt=0, lt=1, description="share of a frame's points that must find a partner"
    )
    max_residual: PositiveFloat = Field(
        default=5.0,
        le=1000,
        description="mean residual in standard deviations of the sensor's noise beyond which none fits",
    )
    degenerate_sigma_m: PositiveFloat = Field(
        default=0.01, le=10, description="a direction less certain than this after one frame is left to the prior"
    )
    other_prior_share: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="another motion than the one expected first fills unseen directions where it is off what is seen "
        "by less than this share; found on the simulator alone, with wheels that slip",
    )
    color_error_left: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="of `color_sigma_px`, what is left between two images of a colour camera that is off alike in both",
    )
    correlation: PositiveFloat = Field(
        default=20.0, le=1e6, description="how many neighbouring residuals err as one; variances are that much larger"
    )
    prior_sigma_m_s: PositiveFloat = Field(
        default=0.5,
        le=100,
        description="how far off the expected speed may be, a second; what unseen directions are worth",
    )
    nonholonomic_share: float = Field(
        default=0.15, gt=0, le=1, description="of that, how far a base on wheels may go sideways, rise or tilt instead"
    )
    min_depth_share: float = Field(default=0.05, gt=0, lt=1, description="of a frame's pixels that must have depth")
    dark_grey: NonNegativeFloat = Field(
        default=12.0, le=255, description="grey that is left in the dark, which is noise (real Kinects, lens covered)"
    )
    dark_share: float = Field(
        default=0.01,
        ge=0,
        le=1,
        description="an image is dark where fewer of its pixels than this are brighter than that",
    )
    kept_keyframes: PositiveInt = Field(
        default=60, le=10_000, description="held in memory; those used longest ago go first"
    )
    max_unseen_s: PositiveFloat = Field(
        default=0.5,
        le=3600,
        description="how long a direction of motion may stay unseen where nothing but the camera tells it",
    )
    max_speed_m_s: PositiveFloat = Field(default=3.0, le=100, description="a faster motion is implausible")
    max_turn_rad_s: PositiveFloat = Field(default=8.0, le=100, description="a faster turn is implausible")
    lost_after: PositiveInt = Field(
        default=10, le=1_000_000, description="failed frames in a row, after which the state is lost"
    )
    threads: PositiveInt = Field(default=2, le=64, description="that share a frame's rows")
    starts: StartSettings = StartSettings()
    faults: FaultSettings = FaultSettings()
    delay: DelaySettings = DelaySettings()
    joint: JointSettings = JointSettings()
    verification: VerificationSettings = VerificationSettings()
    keyframes: KeyframeSettings = KeyframeSettings()
    vignetting: VignettingSettings = VignettingSettings()
