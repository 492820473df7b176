"""FeatureSettings: what can be set about feature odometry, with the reasons for the defaults."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, PositiveFloat, PositiveInt


class FeatureSettings(BaseModel):
    """Settings of feature odometry; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

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
    pyramid_levels: int = Field(default=8, ge=1, le=12, description="image scales, each 1.2 times smaller")
    cell_px: int = Field(default=64, ge=8, le=4096, description="cells in which keypoints compete when they are spread")
    depth_jump: PositiveFloat = Field(
        default=0.03,
        le=1,
        description="share of the depth by which readings around a keypoint may differ, at 525 px focal length and "
        "more, in proportion, at less; beyond that is an edge",
    )

    max_hamming: int = Field(default=64, ge=1, le=256, description="bits by which descriptors of one point may differ")
    search_radius_px: PositiveFloat = Field(default=12.0, le=1000, description="around a landmark's predicted pixel")
    ransac_iterations: PositiveInt = Field(default=300, le=100_000, description="at most; fewer when most pairs agree")
    min_inliers: int = Field(
        default=15, ge=4, le=20_000, description="point pairs that must agree before a motion is believed"
    )
    max_sigma_m: PositiveFloat = Field(default=0.10, le=10, description="a motion less certain than this is no answer")
    max_sigma_rad: PositiveFloat = Field(
        default=0.05, le=3, description="a rotation less certain than this is no answer"
    )
    max_speed_m_s: PositiveFloat = Field(default=5.0, le=100, description="a faster motion is implausible")
    max_turn_rad_s: PositiveFloat = Field(default=8.0, le=100, description="a faster turn is implausible")

    keyframe_share: float = Field(
        default=0.45, gt=0, le=1, description="of a keyframe's landmarks; when fewer are seen, a new keyframe is made"
    )
    local_keyframes: PositiveInt = Field(
        default=30, le=1000, description="nearest keyframes whose landmarks are searched"
    )
    kept_keyframes: PositiveInt = Field(default=300, le=100_000, description="held in memory; the oldest go first")
    lost_after: PositiveInt = Field(
        default=10, le=1_000_000, description="failed frames in a row, after which the state is lost (paper: N)"
    )
