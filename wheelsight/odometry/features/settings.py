"""FeatureSettings: what can be set about feature odometry, with the reasons for the defaults."""

from __future__ import annotations

from typing import Literal

from wheelsight.odometry.velocity import LONGEST_STEP_S
from wheelsight.settings import CHOSEN, ON_SIMULATOR, Settings, setting


class FeatureSettings(Settings):
    """Settings of feature odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = setting(
        "keyframes",
        "align with landmarks of near keyframes, or with the previous frame as in the paper",
        "Zhang, Fig. 3, for the previous frame; keyframes drift less",
    )
    seed: int = setting(0, "of RANSAC; one seed gives one trajectory", CHOSEN, ge=0, lt=2**32)

    keypoints: int = setting(1000, "kept in each frame, spread over the image", CHOSEN, ge=50, le=20_000)
    candidates: int = setting(2000, "detected before spreading", CHOSEN, ge=50, le=50_000)
    fast_threshold: int = setting(
        20,
        "grey levels by which a corner's ring must differ",
        "Rublee et al. 2011 (ORB); docs/decisions/0023",
        gt=0,
        le=255,
    )
    fast_threshold_faint: int = setting(
        7, "the same where an image has too few clear corners", "docs/decisions/0023", gt=0, le=255
    )
    pyramid_levels: int = setting(8, "image scales", "Rublee et al. 2011 (ORB), as OpenCV has it", ge=1, le=12)
    pyramid_scale: float = setting(
        1.2, "each level is so many times smaller", "Rublee et al. 2011 (ORB), as OpenCV has it", gt=1, le=2
    )
    sigma_px: float = setting(
        0.65,
        "standard deviation of a keypoint's pixel on the full image",
        "measured by python -m benchmarks.sensor on two Kinect recordings",
        gt=0,
        le=10,
    )
    sigma_growth: float = setting(
        1.12,
        "by which it grows a level: more slowly than the level's pixels do",
        "measured by python -m benchmarks.sensor on two Kinect recordings",
        ge=1,
        le=2,
    )
    cell_px: int = setting(
        64, "cells in which keypoints compete when they are spread", "docs/decisions/0023", ge=8, le=4096
    )
    depth_jump: float = setting(
        0.03,
        "share of the depth by which readings around a keypoint may differ, at 525 px focal length and more, in "
        "proportion, at less; beyond that is an edge",
        CHOSEN,
        gt=0,
        le=1,
    )
    depth_jump_focal_px: float = setting(
        525.0,
        "focal length of `depth_jump`, that of a Kinect: a surface seen at a slant differs from pixel to pixel by "
        "its slope times the pixel's angle",
        "a Kinect's",
        gt=0,
        le=1e5,
    )

    max_hamming: int = setting(64, "bits by which descriptors of one point may differ", CHOSEN, ge=1, le=256)
    distinct_share: float = setting(
        0.9,
        "of the bits by which the second best descriptor nearby differs, which the best must stay below (and 1 "
        "bit): else the texture repeats itself",
        CHOSEN,
        gt=0,
        le=1,
    )
    search_radius_px: float = setting(12.0, "around a landmark's predicted pixel", CHOSEN, gt=0, le=1000)
    prior_radii: float = setting(
        3.0,
        "search radii around what an expected motion predicts: it is a hint, not a measurement",
        CHOSEN,
        gt=0,
        le=100,
    )
    prior_share: float = setting(
        0.25,
        "of the reference's points; with fewer found, the expected motion is wrong or much has left the image, and"
        " all keypoints are searched",
        CHOSEN,
        ge=0,
        le=1,
    )
    ransac_iterations: int = setting(300, "at most; fewer when most pairs agree", CHOSEN, gt=0, le=100_000)
    ransac_chi2: float = setting(
        36.0,
        "χ² of a pair that agrees with a hypothesis; wide, since three noisy points make a rough one",
        CHOSEN,
        gt=0,
        le=1e4,
    )
    triangle_m: float = setting(
        0.05, "least side of the three points of a hypothesis; smaller ones tell no rotation", CHOSEN, gt=0, le=10
    )
    triangle_change_m: float = setting(
        0.05, "by which a side may differ between both frames, and by", CHOSEN, ge=0, le=10
    )
    triangle_change_share: float = setting(
        0.03, "of its length, as depth is uncertain: else the points do not belong together", CHOSEN, ge=0, le=1
    )
    inlier_chi2: float = setting(
        16.3,
        "χ² of a pair that agrees with a motion: of three numbers, 99.9 % lie below",
        "reckoned: χ² of 3",
        gt=0,
        le=1e4,
    )
    refinement_steps: int = setting(8, "of Gauss and Newton, at most", CHOSEN, gt=0, le=1000)
    min_inliers: int = setting(15, "point pairs that must agree before a motion is believed", CHOSEN, ge=4, le=20_000)
    max_sigma_m: float = setting(0.10, "a motion less certain than this is no answer", CHOSEN, gt=0, le=10)
    max_sigma_rad: float = setting(0.05, "a rotation less certain than this is no answer", CHOSEN, gt=0, le=3)
    max_speed_m_s: float = setting(5.0, "a faster motion is implausible", CHOSEN, gt=0, le=100)
    max_turn_rad_s: float = setting(8.0, "a faster turn is implausible", CHOSEN, gt=0, le=100)

    longest_step_s: float = setting(
        LONGEST_STEP_S,
        "over a longer gap between two frames their mean velocity says little about that at the frame",
        ON_SIMULATOR,
        gt=0,
        le=10,
    )

    keyframe_share: float = setting(
        0.45, "of a keyframe's landmarks; when fewer are seen, a new keyframe is made", CHOSEN, gt=0, le=1
    )
    local_keyframes: int = setting(30, "nearest keyframes whose landmarks are searched", CHOSEN, gt=0, le=1000)
    view_distance_m: float = setting(
        2.0, "keyframes are near where the points this far before the cameras are", CHOSEN, gt=0, le=100
    )
    kept_keyframes: int = setting(300, "held in memory; the oldest go first", CHOSEN, gt=0, le=100_000)
    lost_after: int = setting(
        10,
        "failed frames in a row, after which the state is lost",
        "Zhang, Fig. 3, N; the paper names no figure",
        gt=0,
        le=1_000_000,
    )
