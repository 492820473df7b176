"""FeatureSettings: what can be set about feature odometry, with the reasons for the defaults."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from wheelsight.odometry._velocity import LONGEST_STEP_S
from wheelsight.settings import Settings


class FeatureSettings(Settings):
    """Settings of feature odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = Field(
        default="keyframes",
        description="align with landmarks of near keyframes, or with the previous frame as in the paper",
    )
    seed: NonNegativeInt = Field(default=0, lt=2**32, description="of RANSAC; one seed gives one trajectory")

    keypoints: int = Field(default=1000, ge=50, le=20_000, description="kept in each frame, spread over the image")
    candidates: int = Field(default=2000, ge=50, le=50_000, description="detected before spreading")
    fast_threshold: PositiveInt = Field(
        default=20, le=255, description="grey levels by which a corner's ring must differ"
    )
    fast_threshold_faint: PositiveInt = Field(
        default=7, le=255, description="the same where an image has too few clear corners"
    )
    pyramid_levels: int = Field(default=8, ge=1, le=12, description="image scales")
    pyramid_scale: float = Field(default=1.2, gt=1, le=2, description="each level is so many times smaller (ORB: 1.2)")
    sigma_px: PositiveFloat = Field(
        default=0.65,
        le=10,
        description="standard deviation of a keypoint's pixel on the full image, measured on two Kinect recordings "
        "(python -m benchmarks.sensor)",
    )
    sigma_growth: float = Field(
        default=1.12,
        ge=1,
        le=2,
        description="by which it grows a level, measured likewise: more slowly than the level's pixels do",
    )
    cell_px: int = Field(default=64, ge=8, le=4096, description="cells in which keypoints compete when they are spread")
    depth_jump: PositiveFloat = Field(
        default=0.03,
        le=1,
        description="share of the depth by which readings around a keypoint may differ, at 525 px focal length and "
        "more, in proportion, at less; beyond that is an edge",
    )
    depth_jump_focal_px: PositiveFloat = Field(
        default=525.0,
        le=1e5,
        description="focal length of `depth_jump`, that of a Kinect: a surface seen at a slant differs from pixel to "
        "pixel by its slope times the pixel's angle",
    )

    max_hamming: int = Field(default=64, ge=1, le=256, description="bits by which descriptors of one point may differ")
    distinct_share: float = Field(
        default=0.9,
        gt=0,
        le=1,
        description="of the bits by which the second best descriptor nearby differs, which the best must stay below "
        "(and 1 bit): else the texture repeats itself",
    )
    search_radius_px: PositiveFloat = Field(default=12.0, le=1000, description="around a landmark's predicted pixel")
    prior_radii: PositiveFloat = Field(
        default=3.0,
        le=100,
        description="search radii around what an expected motion predicts: it is a hint, not a measurement",
    )
    prior_share: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="of the reference's points; with fewer found, the expected motion is wrong or much has left the "
        "image, and all keypoints are searched",
    )
    ransac_iterations: PositiveInt = Field(default=300, le=100_000, description="at most; fewer when most pairs agree")
    ransac_chi2: PositiveFloat = Field(
        default=36.0,
        le=1e4,
        description="χ² of a pair that agrees with a hypothesis; wide, since three noisy points make a rough one",
    )
    triangle_m: PositiveFloat = Field(
        default=0.05, le=10, description="least side of the three points of a hypothesis; smaller ones tell no rotation"
    )
    triangle_change_m: NonNegativeFloat = Field(
        default=0.05, le=10, description="by which a side may differ between both frames, and by"
    )
    triangle_change_share: NonNegativeFloat = Field(
        default=0.03, le=1, description="of its length, as depth is uncertain: else the points do not belong together"
    )
    inlier_chi2: PositiveFloat = Field(
        default=16.3, le=1e4, description="χ² of a pair that agrees with a motion: of three numbers, 99.9 % lie below"
    )
    refinement_steps: PositiveInt = Field(default=8, le=1000, description="of Gauss and Newton, at most")
    min_inliers: int = Field(
        default=15, ge=4, le=20_000, description="point pairs that must agree before a motion is believed"
    )
    max_sigma_m: PositiveFloat = Field(default=0.10, le=10, description="a motion less certain than this is no answer")
    max_sigma_rad: PositiveFloat = Field(
        default=0.05, le=3, description="a rotation less certain than this is no answer"
    )
    max_speed_m_s: PositiveFloat = Field(default=5.0, le=100, description="a faster motion is implausible")
    max_turn_rad_s: PositiveFloat = Field(default=8.0, le=100, description="a faster turn is implausible")

    longest_step_s: PositiveFloat = Field(
        default=LONGEST_STEP_S,
        le=10,
        description="over a longer gap between two frames their mean velocity says little about that at the frame",
    )

    keyframe_share: float = Field(
        default=0.45, gt=0, le=1, description="of a keyframe's landmarks; when fewer are seen, a new keyframe is made"
    )
    local_keyframes: PositiveInt = Field(
        default=30, le=1000, description="nearest keyframes whose landmarks are searched"
    )
    view_distance_m: PositiveFloat = Field(
        default=2.0, le=100, description="keyframes are near where the points this far before the cameras are"
    )
    kept_keyframes: PositiveInt = Field(default=300, le=100_000, description="held in memory; the oldest go first")
    lost_after: PositiveInt = Field(
        default=10, le=1_000_000, description="failed frames in a row, after which the state is lost (paper: N)"
    )
