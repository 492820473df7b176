"""Parts of DenseSettings, one for each decision of dense odometry: units, reasons, and where a default was found."""

from __future__ import annotations

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from wheelsight.settings import Settings


class StartSettings(Settings):
    """From which of several guesses alignment begins, and which of its outcomes is taken."""

    turn_misfit: float = Field(
        default=3.0,
        ge=1,
        le=100,
        description="a turn by grey is dropped where points then lie so many times as far from planes; depth and "
        "colour of a frame are seldom of one instant, so grey may be right where planes are worse (real recordings)",
    )
    unpaired_sigmas: PositiveFloat = Field(
        default=5.0, le=100, description="standard deviations that a point counts as off which has no plane near it"
    )
    clearly_nearer: float = Field(
        default=1.5,
        ge=1,
        le=100,
        description="another guess than the first is begun with where points lie so many times as near to planes; "
        "found on the simulator alone, with wheels that spin",
    )
    as_many_planes: float = Field(
        default=0.7,
        gt=0,
        le=1,
        description="share of the first outcome's planes that another must find for grey to decide between both; "
        "found on the simulator alone, with wheels that slip along walls",
    )
    as_near_planes: float = Field(
        default=1.1, ge=1, le=100, description="and so many times the first one's residual it may have; likewise"
    )
    clearer_grey: float = Field(
        default=0.85, gt=0, le=1, description="it is taken where grey spreads by less than this share; likewise"
    )


class FaultSettings(Settings):
    """Which poses by surfaces are suspected, so that keypoints must verify them."""

    leap_m_s: PositiveFloat = Field(
        default=0.5, le=100, description="metres a second that the camera may gain at once; more is a leap"
    )
    leap_m_s2: NonNegativeFloat = Field(
        default=10.0, le=1000, description="and that much more for each second since the frame before"
    )
    leap_rad_s: PositiveFloat = Field(
        default=1.5, le=100, description="radians a second that it may gain at once; hand-held cameras gain less"
    )
    leap_rad_s2: NonNegativeFloat = Field(
        default=30.0, le=1000, description="and that much more for each second since the frame before"
    )
    off_prior_m_s: PositiveFloat = Field(
        default=0.2,
        le=100,
        description="metres a second off a motion handed in: more than wheels err that do not slip (2 % of the radius "
        "at 1 m/s is a tenth of it); found on the simulator alone, with people who walk by",
    )
    off_prior_rad_s: PositiveFloat = Field(
        default=0.2,
        le=100,
        description="radians a second likewise (3 % of the track at 90 degrees/s is a quarter of it)",
    )
    bridged_s: NonNegativeFloat = Field(
        default=10.0,
        le=3600,
        description="seconds of a gap that a motion handed in bridges; wheels are no farther off then than the next "
        "two say; found on the simulator alone, a camera covered on ten drives",
    )
    bridged_off_m: PositiveFloat = Field(
        default=0.05,
        le=10,
        description="metres off that motion at which a pose after a gap needs no keypoints; likewise",
    )
    bridged_off_rad: PositiveFloat = Field(default=0.03, le=3.2, description="and radians; likewise")
    poor_fit: float = Field(
        default=2.0,
        ge=1,
        le=100,
        description="planes that lie so many times as far off as usual are suspected, if no motion is handed in; wrong "
        "poses had 4 to 5 times (eight simulated flats); on a real hand-held recording that much is usual, and learned",
    )
    fit_learned: float = Field(
        default=0.1, gt=0, le=1, description="of a frame's residual that goes into what is usual, so within ten frames"
    )


class VerificationSettings(Settings):
    """When a pose by keypoints says the same as one by surfaces, and which of both counts."""

    agree_m: PositiveFloat = Field(
        default=0.04, le=10, description="metres between both poses that still are the same: keypoints err by 1 to 2 cm"
    )
    agree_rad: PositiveFloat = Field(default=0.035, le=3.2, description="radians likewise, 2 degrees")
    vague: float = Field(
        default=4.0,
        ge=1,
        le=100,
        description="so many times as far apart too, where keypoints are no surer: far ones hardly tell a turn from a "
        "way aside, 0.1 m and 0.9 degrees at 7 m; found on the simulator alone",
    )
    agree_chi2: PositiveFloat = Field(
        default=16.8, le=1e6, description="how sure they may be then at most: chi² of 6, 99 %, by their own covariance"
    )
    correlation: PositiveFloat = Field(
        default=20.0,
        le=1e6,
        description="how many neighbouring keypoints err as one, as pixels do, where they are weighed against surfaces",
    )
    clear_inliers: PositiveInt = Field(
        default=60, le=100_000, description="keypoints that must agree for them to count against surfaces"
    )
    clear_share: float = Field(
        default=0.6,
        gt=0,
        le=1,
        description="and what share of those matched: in crowds and in places that look alike less",
    )
    likely_share: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="of those matched that agree where a place was seen before: 63 to 96 % at the right place, 19 to "
        "26 % in another stretch of the corridor; found on the simulator alone, eight drives",
    )
    anywhere_s: NonNegativeFloat = Field(
        default=2.0,
        le=3600,
        description="seconds without a pose, and alone, after which the camera may be anywhere, so that `likely_share` "
        "is needed; after one second the right place in a corridor is recognised by less (simulator alone)",
    )


class JointSettings(Settings):
    """How much surfaces count beside keypoints."""

    first_factor: float = Field(
        default=1.0,
        ge=1,
        le=1e6,
        description="on the covariance that surfaces claim, before anything is seen of the camera",
    )
    learned: float = Field(
        default=0.1, gt=0, le=1, description="of what a frame says of that factor, so within ten frames"
    )
    at_once: float = Field(
        default=0.2,
        ge=0,
        le=1,
        description="of what a frame says, which counts for that frame itself: a quick turn parts colour and depth "
        "that are not of one instant, and is over before it is learned",
    )
    shown: PositiveFloat = Field(
        default=1.0,
        le=1e6,
        description="times the information of keypoints that surfaces must claim along a direction to be judged by it",
    )
    most: PositiveFloat = Field(default=1e4, le=1e9, description="a larger factor says no more than that")


class DelaySettings(Settings):
    """How the time between colour and depth is learned, beyond what their stamps say."""

    sigma_s: float = Field(
        default=0.015, ge=0, le=1, description="how far off the calibration's delay may be; 0 learns nothing"
    )
    walk_s: NonNegativeFloat = Field(
        default=0.0002, le=1, description="by which the delay may change from frame to frame"
    )
    turn_sigma_rad: PositiveFloat = Field(
        default=0.02,
        le=3,
        description="by which keypoints and surfaces differ about a frame's turn for other reasons",
    )
    clear_sigmas: PositiveFloat = Field(
        default=3.0, le=100, description="standard deviations by which a delay must differ to be put in use"
    )
    least_rad_s: PositiveFloat = Field(default=0.2, le=10, description="a slower turn tells no delay")
    most_rad: PositiveFloat = Field(default=0.15, le=3, description="a larger difference is no delay")
    most_s: PositiveFloat = Field(default=0.05, le=1, description="a longer delay is none: one frame and a half")


class KeyframeSettings(Settings):
    """Where a keyframe is put, and how straight its rows must be."""

    fineness: float = Field(
        default=0.8,
        gt=0,
        le=1,
        description="of a frame's resolution, what a keyframe must have to show it: along a corridor a frame is 3 mm "
        "off at half of it, 1 mm at this, and keypoints are recognised (simulator alone)",
    )
    kept_straight_px: NonNegativeFloat = Field(
        default=0.3, le=100, description="pixels that rows of a keyframe may be off before it is straightened again"
    )
    straight_px: NonNegativeFloat = Field(
        default=1.0, le=100, description="and rows of a frame that is no keyframe: it costs 2 ms"
    )
    short_motions: PositiveFloat = Field(
        default=2.0,
        le=100,
        description="times that the covariance of the motion from the last keyframe counts beside that from the one "
        "before: where the two are against each other was found by a motion like it",
    )
    joined_chi2: PositiveFloat = Field(
        default=22.5, le=1e6, description="how far apart both may be to say the same: chi² of 6, 99.9 %"
    )


class VignettingSettings(Settings):
    """What is known of lenses before anything is seen, and which pixels tell more."""

    sigma: PositiveFloat = Field(
        default=0.3,
        le=10,
        description="standard deviation of the exponent of cos⁴ before anything is seen: 0.22 for the simulated "
        "camera, 0.10 and 0.06 for two real ones",
    )
    max_exponent: NonNegativeFloat = Field(default=1.0, le=10, description="beyond which no lens goes: cos⁴ itself")
    uneven: PositiveFloat = Field(
        default=0.01, le=10, description="logarithm of grey by which a place's light differs from view to view"
    )
    correlation: PositiveFloat = Field(default=20.0, le=1e6, description="how many neighbouring pixels err as one")
    min_pixels: PositiveInt = Field(
        default=300, le=1_000_000, description="compared pixels below which nothing is learned"
    )
    darkest: NonNegativeFloat = Field(default=20.0, le=255, description="grey below this is noise")
    brightest: PositiveFloat = Field(default=235.0, le=255, description="grey above this may be cut off")
