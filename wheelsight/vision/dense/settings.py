"""`DenseSettings` configures dense odometry."""

from __future__ import annotations

from typing import Literal

from wheelsight.core.settings import ASKED, CHOSEN, Settings, setting


class DenseSettings(Settings):
    """Settings of dense odometry; unknown names are refused."""

    reference: Literal["keyframes", "previous"] = setting(
        "keyframes", "the view that a frame is aligned with where no map predicts one", ASKED
    )
    finest_width_px: int = setting(400, "images wider than this are halved until they are not", CHOSEN, ge=16, le=8192)
    color_weight: float = setting(0.7, "of grey values against depth; 0 aligns depth alone", CHOSEN, ge=0, le=100)
    keyframe_overlap: float = setting(
        0.75, "share of a keyframe in view below which a new one is made", CHOSEN, gt=0, lt=1
    )
    keyframe_way_m: float = setting(
        0.3,
        "beside a map: distance from the nearest keyframe to a new one; a rotation by a radian counts as 1.5 m",
        CHOSEN,
        gt=0,
        le=100,
    )
    kept_keyframes: int = setting(
        60,
        "held in memory as views; the least recently used are dropped, and return with the camera",
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
    max_turn_rad_s: float = setting(8.0, "a faster rotation is implausible", CHOSEN, gt=0, le=100)
    lost_after: int = setting(
        10,
        "consecutive failed frames after which the state is lost",
        "Zhang, Fig. 3, N; the paper names no figure",
        gt=0,
        le=1_000_000,
    )
