"""PeopleSettings: when something that a depth camera sees is taken for somebody who walks."""

from __future__ import annotations

from wheelsight.settings import CHOSEN, Settings, setting


class PeopleSettings(Settings):
    """How things that move are found, followed and told to controllers."""

    is_predicted: bool = setting(
        True, "whether controllers are told who walks where; else who walks is an obstacle where he was seen", CHOSEN
    )
    gap_m: float = setting(
        0.4,
        "between points of one thing, at most: legs that step, and points of a wall that is seen along itself, whose "
        "gaps move as the camera does",
        CHOSEN,
        gt=0,
        le=1,
    )
    least_points: int = setting(3, "cells that a thing fills, at least", CHOSEN, ge=1, le=100)
    widest_m: float = setting(1.0, "a thing that is wider is no person", CHOSEN, gt=0.2, le=3)
    body_m: float = setting(
        0.25,
        "radius of a person, of whom only the near side is seen",
        "Neufert: 0.5 m from elbow to elbow",
        gt=0.05,
        le=1,
    )
    beside_m: float = setting(
        0.15, "what is nearer to an obstacle of the map is that obstacle: a place is off by as much", CHOSEN, ge=0, le=1
    )
    sigma_m: float = setting(
        0.05, "standard deviation of where a thing's middle is seen: half a step's swing of arms", CHOSEN, gt=0, le=1
    )
    sigma_rad: float = setting(
        0.01, "the same across, for each metre of distance: heading of the pose of a frame", CHOSEN, ge=0, le=0.2
    )
    walk_m_s: float = setting(1.0, "standard deviation of a speed that is not known yet: a walk", CHOSEN, gt=0, le=5)
    change_m2_s3: float = setting(
        0.1,
        "by which the square of a speed's deviation grows each second: who walks holds a speed for some seconds",
        CHOSEN,
        gt=0,
        le=10,
    )
    gate: float = setting(0.99, "of χ², within which what is seen is where somebody was expected", CHOSEN, gt=0.5, lt=1)
    sure: float = setting(0.99, "of χ², beyond which a speed is more than an error of it", CHOSEN, gt=0.5, lt=1)
    least_m_s: float = setting(0.3, "slower than this nobody walks", CHOSEN, ge=0, le=2)
    frames: int = setting(
        5, "in which something is seen before it can walk: half a second of a Kinect", CHOSEN, ge=3, le=50
    )
    way_m: float = setting(
        0.2, "way made in these frames, at least: shapes seen from elsewhere shift by less", CHOSEN, ge=0, le=2
    )
    unseen_s: float = setting(1.0, "time out of sight after which somebody is forgotten", "issue 32", gt=0, le=10)
    trail_s: float = setting(
        1.0,
        "time for which who walks is taken out of the costmap's obstacles: as long as it takes to know that he walks; "
        "heights at which he was seen from afar no image sees through from nearby",
        "reckoned",
        ge=0,
        le=5,
    )
    trail_m: float = setting(0.15, "about his circle, as far as that goes: cells and errors", CHOSEN, ge=0, le=1)
