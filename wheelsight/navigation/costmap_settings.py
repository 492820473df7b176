"""CostmapSettings and LiveLayerSettings: what can be set about what a planner and a controller go by."""

from __future__ import annotations

from typing import Literal

from wheelsight.settings import CHOSEN, Settings, setting

_AS_OCCUPANCY = "as the occupancy map's; see docs/occupancy.md"


class CostmapSettings(Settings):
    """What driving costs, cell by cell."""

    unknown: Literal["forbidden", "costly"] = setting(
        "forbidden", "whether the robot may drive where nobody has seen the floor: not with a person in it", CHOSEN
    )
    unknown_cost: float = setting(
        0.5, "share of the highest cost that unknown floor has, where it is costly", CHOSEN, ge=0, le=1
    )
    inflation_m: float = setting(
        0.6, "metres beyond the inscribed radius up to which nearness to obstacles costs anything", CHOSEN, ge=0, le=5
    )
    decay_per_m: float = setting(
        5.0, "by which cost falls there: exp(-decay · distance); at 0.3 m a quarter is left", CHOSEN, gt=0, le=50
    )


class LiveLayerSettings(Settings):
    """Obstacles that the newest depth images show."""

    size_m: float = setting(
        14.0,
        "side of the square about the robot that is kept, metres: farther than the camera sees",
        CHOSEN,
        ge=2,
        le=60,
    )
    resolution_m: float = setting(0.05, "side of a cell, metres", "what Nav2's maps have", ge=0.01, le=0.5)
    floor_m: float = setting(
        0.05, "what is seen higher is an obstacle, metres: casters climb less", _AS_OCCUPANCY, gt=0, le=1
    )
    drop_m: float = setting(
        0.1, "where a ray goes on so far below the floor, metres, the floor is missing", _AS_OCCUPANCY, gt=0, le=1
    )
    tilt_rad: float = setting(
        0.015, "added to both for each metre of distance: the mount is known to a degree", _AS_OCCUPANCY, ge=0, le=0.2
    )
    height_m: float = setting(
        1.4, "up to where things are in the robot's way, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    layer_m: float = setting(
        0.1, "height of a layer, metres: a ray below a table says nothing about its top", _AS_OCCUPANCY, gt=0, le=5
    )
    far_m: float = setting(
        4.5,
        "nothing farther along the floor is used, metres: a Kinect's depth errs by 3 cm there",
        "reckoned",
        gt=0,
        le=30,
    )
    period_s: float = setting(
        0.09,
        "an image sooner than that after the last one is left out, for the collision monitor sees each: two cores have "
        "no time for more",
        CHOSEN,
        ge=0,
        le=1,
    )
    columns: int = setting(
        80,
        "columns of square blocks of pixels, each of which clears as one ray, as far as its nearest pixel says: "
        "as many in large images, so that they take no longer",
        CHOSEN,
        ge=8,
        le=2000,
    )
    measured: float = setting(
        0.5,
        "least share of a block's pixels with a depth, else it clears nothing: black and glass have none",
        CHOSEN,
        ge=0,
        le=1,
    )
    passes: int = setting(
        2,
        "images that have to see through a layer of a cell before what was met there is gone: one may look past a leg "
        "of a chair; at 5 images a second it is gone within half a second",
        CHOSEN,
        ge=1,
        le=20,
    )
    standing_s: float = setting(
        2.0,
        "what was met in a cell first less long ago may be somebody who walks by: plans lead on there, and controllers "
        "go round or wait, for less than a way round takes; who crosses a way is on it for 1.5 s",
        CHOSEN,
        ge=0,
        le=10,
    )
    forget_s: float = setting(
        3.0, "where no image looks, what was met for a moment is gone after this time", CHOSEN, ge=0, le=60
    )
    stays: float = setting(
        10.0,
        "and what was met for longer, after so many times as long besides: who stood for 3 s, after half a minute",
        CHOSEN,
        ge=0,
        le=1000,
    )
    settled_s: float = setting(
        10.0,
        "what has stood for so long is nobody who walks: it is not forgotten after a behaviour, as all else is, so "
        "that who has gone does not stay",
        CHOSEN,
        ge=0,
        le=600,
    )
    margin_sigmas: float = setting(
        3.0,
        "standard deviations of depth, and a cell, before a ray's end within which it clears nothing",
        CHOSEN,
        ge=0,
        le=20,
    )
