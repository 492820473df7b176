"""Settings of navigation: navigator, costmap, planner, controllers, collision monitor and people tracking."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from wheelsight.core.robots import RobotLimits
from wheelsight.core.settings import CHOSEN, Settings, conflict, setting
from wheelsight.navigation.footprint import Footprint

# CostmapSettings and LiveLayerSettings: what can be set about what a planner and a controller go by.


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


# PlannerSettings: what can be set about plans, with the reasons for the defaults.


class PlannerSettings(Settings):
    """How ways to a goal are planned."""

    margin_m: float = setting(
        0.025,
        "clearance that every pose of a plan keeps, metres; from one to the next no point of the robot moves more than "
        "twice as far, hence it is free between them, too",
        CHOSEN,
        ge=0.01,
        le=1,
    )
    wanted_margin_m: float = setting(
        0.1,
        "clearance that is kept where there is room, metres: what the localization may be off by",
        CHOSEN,
        ge=0,
        le=1,
    )
    tight_cost: float = setting(
        4.0,
        "that a metre costs more where the least clearance alone is kept, and by the square of what it lacks between; "
        "a free metre costs 1",
        "80 plans in four real buildings: 1 nearer than 5 cm to anything, 7 with a cost of 2; docs/decisions/0062",
        ge=0,
        le=100,
    )
    nearness_cost: float = setting(
        1.0, "that a metre costs more where the costmap's cost is 1; in proportion below", CHOSEN, ge=0, le=100
    )
    usual_m_s: float = setting(
        0.6, "speed of most drives: a metre costs more in zones that are slower, as the time does", CHOSEN, gt=0, le=3
    )
    turn_m: float = setting(
        0.5,
        "metres that a turn in place of 1 rad costs as much as: both take half a second to a second",
        CHOSEN,
        ge=0,
        le=10,
    )
    bend_m: float = setting(0.1, "metres that 1 rad of turning costs, while it drives", CHOSEN, ge=0, le=10)
    backward_cost: float = setting(
        4.0, "times as much as a metre forward: no camera looks there, and it is slower", CHOSEN, ge=1, le=100
    )
    switch_m: float = setting(0.5, "metres that changing between forward and backward costs", CHOSEN, ge=0, le=10)
    radius_m: float = setting(0.4, "least radius of curves; narrower ones are turns in place", CHOSEN, gt=0, le=5)
    headings: int = setting(
        72, "that the search tells apart: 5° each, over which the far end of a chair moves 7 cm", CHOSEN, ge=16, le=360
    )
    place_m: float = setting(
        0.1,
        "side of the squares in which the search tells places apart, metres; half of it in narrow places",
        CHOSEN,
        gt=0.005,
        le=1,
    )
    narrow_m: float = setting(
        0.2, "a place is narrow where obstacles are nearer to the robot's inscribed circle, metres", CHOSEN, ge=0, le=5
    )
    stride_m: float = setting(
        0.1, "length of the search's arcs, metres; at least so long that they leave their cell", CHOSEN, gt=0, le=1
    )
    greed: float = setting(
        1.6,
        "factor on what is guessed to be left; 2 is quicker and nearer to walls",
        "80 plans in four real buildings: docs/decisions/0062",
        ge=1,
        le=10,
    )
    connect_m: float = setting(4.0, "from where on the search tries to reach the goal in one go", CHOSEN, ge=0, le=50)
    most_states: int = setting(
        800_000, "bound on time and memory of a search: 90 MB, ten seconds or more", "reckoned", ge=1_000, le=50_000_000
    )
    goal_tolerance_m: float = setting(
        0.5, "how far from a goal that is occupied the plan may end, metres", CHOSEN, ge=0, le=5
    )
    goal_tolerance_rad: float = setting(0.35, "likewise, how far from its heading", CHOSEN, ge=0, le=3.2)
    escape_nearer_m: float = setting(
        0.01,
        "by how much nearer to an obstacle than it stands such a way out may lead, metres; controllers follow it with "
        "follow.nearer_m",
        CHOSEN,
        ge=0,
        le=0.1,
    )
    escape_m: float = setting(
        1.2, "longest way out, where the robot stands too near to something, metres", CHOSEN, ge=0, le=3
    )
    escape_depth_m: float = setting(
        0.15,
        "how deep a thing may be in the robot's outline for that to be an error of places, metres",
        CHOSEN,
        ge=0,
        le=1,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.wanted_margin_m < self.margin_m:
            raise conflict("wanted_margin_m", "is less than margin_m", "wanted_margin_m ≥ margin_m")
        return self


# Settings of controllers: how a path is followed, and what MPPI and pure pursuit go by.


_KINEMATIC = "found on kinematic drives of the tests alone"


class FollowSettings(Settings):
    """What both controllers share: segments, turns in place, arrival."""

    period_s: float = setting(0.05, "from one command to the next", "issue 32: 20 Hz", gt=0.005, le=0.5)
    lag_s: float = setting(
        0.15, "time constant with which a base follows a command, beside its limits; measure it", CHOSEN, gt=0, le=1
    )
    spacing_m: float = setting(0.05, "between points along a path", "a cell of most maps", gt=0.005, le=0.5)
    margin_m: float = setting(
        0.04,
        "nearer than this to an obstacle no command leads; cells and their distances err by less",
        CHOSEN,
        ge=0,
        le=1,
    )
    nearer_m: float = setting(
        0.02,
        "by how much nearer than it stands a plan may lead that begins nearer to an obstacle than margin_m: what a "
        "corner comes nearer in a turn away from a wall, and by which it is followed inexactly",
        CHOSEN,
        ge=0,
        le=0.1,
    )
    people_margin_m: float = setting(0.15, "the same of people, who may step aside to either side", CHOSEN, ge=0, le=2)
    turn_first_rad: float = setting(
        0.8,
        "heading beside the path's from which a robot that stands turns in place first",
        "Nav2: 0.785",
        gt=0,
        le=3,
    )
    turned_rad: float = setting(0.05, "heading beside the path's at which such a turn ends", CHOSEN, gt=0, le=1)
    ends_turn_rad_s2: float = setting(
        0.6,
        "deceleration toward the end of a turn in place; under what the base can do, since it lags",
        CHOSEN,
        gt=0,
        le=10,
    )
    ends_m_s2: float = setting(
        0.3,
        "deceleration toward the end of a segment; a rider finds more rough, and lag makes it more",
        CHOSEN,
        gt=0,
        le=3,
    )
    slowest_m_s: float = setting(
        0.04, "slower than this no command is, short of a stop: motors do not turn at less", CHOSEN, gt=0, le=0.3
    )
    slowest_rad_s: float = setting(0.06, "the same of turns in place", CHOSEN, gt=0, le=0.5)
    at_end_m: float = setting(0.01, "before a segment's end where it counts as driven", CHOSEN, gt=0, le=0.2)
    at_yaw_rad: float = setting(0.015, "of a turn's end where it counts as turned", CHOSEN, gt=0, le=0.2)
    goal_m: float = setting(
        0.1, "distance from the goal that is an arrival; with what localization is off by, 0.15", "issue 32", gt=0, le=1
    )
    goal_rad: float = setting(0.087, "heading beside the goal's that is one: 5°", "issue 32", gt=0, le=1)
    off_path_m: float = setting(
        1.5,
        "distance from the path beyond which a plan is given up; detours around people are less",
        CHOSEN,
        gt=0,
        le=10,
    )
    stuck_s: float = setting(
        3.0, "time without a way made before a robot that should drive says that it is blocked", CHOSEN, gt=0, le=60
    )
    standing_m_s: float = setting(0.02, "slower than this a robot stands", "encoders' resolution", gt=0, le=0.2)
    standing_rad_s: float = setting(0.05, "the same of turns", "encoders' resolution", gt=0, le=0.5)

    def stands(self, forward_m_s: float, turn_rad_s: float) -> bool:
        """Whether a robot of such speeds stands."""
        return abs(forward_m_s) <= self.standing_m_s and abs(turn_rad_s) <= self.standing_rad_s


class MppiSettings(Settings):
    """Model predictive path integral control; weights are for a second of a rollout where nothing else is said."""

    rollouts: int = setting(2000, "sampled sequences of commands, an even number", "Nav2's default", ge=16, le=100_000)
    steps: int = setting(
        56, "of a period each: 2.8 s ahead, more than the way to a stop", "Nav2's default", ge=8, le=500
    )
    seed: int = setting(20, "of the noise, which is drawn once", "any", ge=0, le=2**31)
    knot_steps: int = setting(
        7,
        "steps between two independent draws, linear between them: white noise hardly moves a robot",
        CHOSEN,
        ge=1,
        le=100,
    )
    fine_share: float = setting(
        0.5,
        "share of rollouts with a quarter of the noise, for exact driving near the last commands",
        CHOSEN,
        ge=0,
        le=1,
    )
    long_share: float = setting(
        0.25,
        "share of rollouts with three draws in all: whoever goes around somebody turns for a second and more",
        _KINEMATIC,
        ge=0,
        le=1,
    )
    spread_m_s: float = setting(0.25, "standard deviation of sampled speeds", CHOSEN, gt=0, le=2)
    spread_rad_s: float = setting(0.5, "the same of turns", CHOSEN, gt=0, le=4)
    temperature: float = setting(
        0.2,
        "cost by which a rollout counts 1/e: lower follows the best, higher is smoother",
        _KINEMATIC,
        gt=0,
        le=100,
    )
    aside: float = setting(80.0, "weight of half a square metre beside the path", _KINEMATIC, ge=0, le=1e4)
    aside_m: float = setting(
        0.1, "distance from the path from which it counts as such and no more as a square", _KINEMATIC, gt=0, le=10
    )
    heading: float = setting(4.0, "weight of 1 - cosine of the heading beside the path's", _KINEMATIC, ge=0, le=1e4)
    progress: float = setting(8.0, "weight of a metre along the path, at the end", _KINEMATIC, ge=0, le=1e4)
    beyond: float = setting(200.0, "weight of a square metre beyond the segment's end", _KINEMATIC, ge=0, le=1e5)
    wrong_way: float = setting(20.0, "weight of a metre a second against the segment's direction", CHOSEN, ge=0, le=1e4)
    too_fast: float = setting(50.0, "weight of a metre a second above a zone's limit", CHOSEN, ge=0, le=1e4)
    cost: float = setting(1.0, "weight of a metre through the field's cost", CHOSEN, ge=0, le=1e4)
    near: float = setting(1.5, "weight of a metre along obstacles, whole at the margin", _KINEMATIC, ge=0, le=1e4)
    near_m: float = setting(0.3, "clearance from which obstacles count", CHOSEN, gt=0, le=2)
    people: float = setting(8.0, "weight of people, whole at their margin", CHOSEN, ge=0, le=1e4)
    people_m: float = setting(0.6, "distance from which people count: a step", CHOSEN, gt=0, le=5)
    change_forward: float = setting(1.0, "weight of a step's change of speed, (m/s)²", CHOSEN, ge=0, le=1e4)
    change_turn: float = setting(0.5, "weight of a step's change of turn, (rad/s)²", CHOSEN, ge=0, le=1e4)
    contact: float = setting(
        1000.0, "cost of coming nearer than a margin: more than all else", "reckoned", gt=0, le=1e9
    )


class PurePursuitSettings(Settings):
    """Regulated pure pursuit (Macenski et al. 2023)."""

    lookahead_s: float = setting(0.8, "time at the present speed to the point that is steered to", CHOSEN, gt=0, le=5)
    least_lookahead_m: float = setting(
        0.5, "nearest such point; nearer ones make a base that lags sway", _KINEMATIC, gt=0.05, le=2
    )
    most_lookahead_m: float = setting(0.9, "farthest such point", "Nav2's default", gt=0.05, le=5)
    curve_m: float = setting(
        0.9, "radius of curves within which it goes slower, in proportion", "Nav2's default", gt=0, le=10
    )
    near_m: float = setting(0.2, "clearance within which it goes slower, in proportion", CHOSEN, gt=0, le=2)
    near_m_s: float = setting(0.15, "the slowest that curves and nearness make it", CHOSEN, gt=0, le=1)
    ahead_s: float = setting(
        0.3, "time that passes before it brakes, when the way that is free is judged", CHOSEN, ge=0, le=5
    )
    braking_share: float = setting(
        0.5, "of the base's braking that is reckoned with before an obstacle", CHOSEN, gt=0, le=1
    )
    step_m: float = setting(0.05, "between poses of an arc that are judged", "a cell of most maps", gt=0.01, le=0.5)


# MonitorSettings: what the collision monitor goes by.


class MonitorSettings(Settings):
    """When a robot goes slower than it is told, and when it stands."""

    margin_m: float = setting(
        0.04, "nearer than this nothing may come; depth at half a metre errs by less", CHOSEN, ge=0, le=1
    )
    reaction_s: float = setting(
        0.3, "from a thing's being seen to the brakes: a frame, a period, the link, the base's lag", CHOSEN, ge=0, le=3
    )
    braking_share: float = setting(
        0.8, "of the limits' braking that is reckoned with; floors are wet, batteries low", CHOSEN, gt=0, le=1
    )
    slow_zone_m: float = setting(0.2, "distance within which things make it slower", CHOSEN, ge=0, le=3)
    slow_m_s: float = setting(0.35, "speed beside things within the slow-down zone", CHOSEN, gt=0, le=3)
    slow_rad_s: float = setting(0.5, "turn beside them", CHOSEN, gt=0, le=4)
    inside_m: float = setting(
        0.1, "a point deeper than this within the outline contradicts it, and nothing moves", CHOSEN, ge=0, le=1
    )
    coasting_m_s: float = setting(0.35, "speed while wheels alone lead", "docs/fusion.md: slows down", gt=0, le=3)
    coasting_rad_s: float = setting(0.5, "turn while wheels alone lead", "docs/fusion.md: slows down", gt=0, le=4)
    frame_age_s: float = setting(
        0.3, "age of the newest usable frame beyond which it stands: 3 frames of 10 a second", CHOSEN, gt=0, le=5
    )
    frame_way_m: float = setting(
        0.24,
        "way driven since the newest usable frame beyond which it stands: at 1 m/s a control period adds 0.05 m, and "
        "0.3 m may be driven blind",
        "issue 32",
        gt=0,
        le=5,
    )
    encoder_age_s: float = setting(
        0.15, "age of the newest wheel reading beyond which it stands: 3 of 20 a second", CHOSEN, gt=0, le=5
    )
    ahead_s: float = setting(0.05, "by which a stamp may lie ahead of now; clocks err by less", CHOSEN, ge=0, le=1)
    seen_share: float = setting(
        0.3,
        "share of bearings that must show something, for a frame to be usable: a hand leaves none",
        CHOSEN,
        ge=0,
        le=1,
    )
    blind_m_s: float = setting(0.2, "speed onto floor that was not seen lately, and backward", CHOSEN, gt=0, le=1)
    blind_rad_s: float = setting(0.5, "turn over floor that was not seen lately", CHOSEN, gt=0, le=4)
    blind_m: float = setting(
        0.3, "how far the outline may reach into floor that was never seen", "issue 32", ge=0, le=2
    )
    lead_m: float = setting(
        0.1,
        "how deep the front may be in floor never seen, for what it passes over to count as seen: a corner leads the "
        "view of 60° by 0.04 m in a turn",
        "reckoned",
        ge=0,
        le=1,
    )
    air_m: float = setting(
        0.5,
        "from the camera, how near it looks over floor that it does not see: what stands up into its lowest ray there "
        "would show. A Kinect measures nothing nearer",
        CHOSEN,
        ge=0,
        le=5,
    )
    fresh_s: float = setting(
        12.0,
        "time for which floor counts as seen; who comes later is seen coming. A chair whose camera sees the floor from "
        "2.3 m on takes 7.5 s at 0.2 m/s until its front is there, and longer where it waits: docs/decisions/0129",
        CHOSEN,
        gt=0,
        le=600,
    )
    remember_s: float = setting(
        600.0,
        "time for which a thing out of sight counts, however little was driven; what has gone is seen through sooner",
        CHOSEN,
        gt=0,
        le=3600,
    )
    remember_m: float = setting(
        10.0,
        "way that the farthest corner may go until then: wheels err by 1 % of it, which is 0.1 m, as inside_m",
        "reckoned",
        gt=0,
        le=1000,
    )
    cell_m: float = setting(0.03, "side of the cells by which floor is remembered", CHOSEN, gt=0.005, le=0.2)
    window_m: float = setting(
        6.0, "side of the square about the robot that is remembered; twice what a stop needs", "reckoned", gt=1, le=40
    )
    history_s: float = setting(
        1.0, "time for which poses by wheels are kept, for frames that come late", CHOSEN, gt=0, le=10
    )
    gap_s: float = setting(
        0.5, "gap between wheel readings after which nobody knows where remembered things are", CHOSEN, gt=0, le=10
    )
    step_m: float = setting(
        0.02, "way of the outline between two poses of an arc that are judged", CHOSEN, gt=0.002, le=0.2
    )


class WheelCheckSettings(Settings):
    """Whether a base does what it is told."""

    off_m_s: float = setting(
        0.15, "speed beyond what acceleration explains: a wheel that hangs is off by half the speed", CHOSEN, gt=0, le=2
    )
    off_rad_s: float = setting(0.3, "turn beyond that likewise", CHOSEN, gt=0, le=4)
    off_s: float = setting(0.3, "for so long", "issue 32", gt=0, le=5)
    lag_s: float = setting(0.3, "the latest that a base answers a command", CHOSEN, ge=0, le=2)
    held_s: float = setting(
        0.2,
        "for which a base keeps a command at least, before it stands by itself",
        "as wheel_control.hold_s",
        gt=0,
        le=5,
    )
    watchdog_s: float = setting(0.25, "and at most", "the firmware's watchdog: docs/serial-link.md", gt=0, le=5)
    slow_share: float = setting(0.5, "of the limits' accelerations that the slowest base still has", CHOSEN, gt=0, le=1)
    fast_share: float = setting(1.5, "of them that the quickest has", CHOSEN, ge=1, le=10)


class ViewSettings(Settings):
    """What a collision monitor is told of a depth image."""

    columns: int = setting(
        64,
        "bearings that the view is cut into, at most one for two pixels of a row: each is 0.9° of a Kinect's",
        CHOSEN,
        ge=8,
        le=1024,
    )
    cell_m: float = setting(0.05, "side of a cell in which pixels are one thing", CHOSEN, gt=0.005, le=0.5)
    pixels: int = setting(
        3, "least pixels of a thing in a cell: at edges single ones lie where nothing is", CHOSEN, ge=1, le=100
    )
    bin_m: float = setting(0.1, "of distance, in which floor was seen or not", CHOSEN, gt=0.01, le=1)
    gap_m: float = setting(
        0.3,
        "without a floor, behind which floor is seen no more: nothing lower than the chair's step hides so little",
        CHOSEN,
        gt=0,
        le=2,
    )


# PeopleSettings: when something that a depth camera sees is taken for somebody who walks.


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


# NavigatorSettings and NavigationSettings: when a robot plans anew, gets itself out, or gives up.


class FootprintSettings(Settings):
    """The robot's outline: a rectangle about the middle of its axle."""

    front_m: float = setting(0.8, "from the axle to the foremost point", "Trinh, section II: 1.10 m", gt=0, le=5)
    back_m: float = setting(0.3, "from the axle to the rearmost point", "Trinh, section II", gt=0, le=5)
    width_m: float = setting(0.6, "of the whole robot", "Trinh, section II", gt=0, le=5)

    @property
    def outline(self) -> Footprint:
        """As planner, controller and collision monitor take it."""
        return Footprint.rectangle(self.front_m, self.back_m, self.width_m)


class BehaviourSettings(Settings):
    """What a robot does that cannot go on."""

    wait_s: float = setting(3.0, "time to wait for somebody to step aside", CHOSEN, ge=0, le=60)
    round_times: float = setting(
        1.5, "so many times what is left of the old way, and round_m, is a way round that waits", CHOSEN, ge=1, le=100
    )
    round_m: float = setting(
        1.0, "likewise: what is driven in the time of a wait, at a walk's pace among people", CHOSEN, ge=0, le=100
    )
    look_rad: float = setting(
        1.0, "turn to either side, to see what is there; the view of a Kinect is 1 rad wide", CHOSEN, gt=0, le=3.2
    )
    search_rad: float = setting(
        6.4, "turn in which a lost robot looks for a place it knows: once around", CHOSEN, gt=0, le=20
    )
    search_m: float = setting(
        1.5,
        "way to the next place where it turns so, over floor that it has seen; 0: it stays where it is. Views are "
        "recognised from about so far away",
        CHOSEN,
        ge=0,
        le=10,
    )
    least_search_m: float = setting(0.5, "less of that shows nothing new, and is not driven", CHOSEN, gt=0, le=10)
    search_m_s: float = setting(0.2, "speed of that", CHOSEN, gt=0, le=0.5)
    turn_rad_s: float = setting(0.4, "speed of such turns; images blur beyond", CHOSEN, gt=0, le=2)
    back_m: float = setting(0.3, "way back, where no camera looks", CHOSEN, gt=0, le=1)
    unseen_back_m: float = setting(
        0.8,
        "way back from floor that was never seen: a chair's camera, 0.35 m ahead of the axle, looks over floor from "
        "0.5 m on, which is where the front was",
        "reckoned",
        gt=0,
        le=3,
    )
    back_m_s: float = setting(0.1, "speed of that", CHOSEN, gt=0, le=0.5)
    refused_s: float = setting(
        2.0, "time for which the collision monitor may hold a behaviour, before it is over", CHOSEN, gt=0, le=60
    )
    clear_m: float = setting(
        0.05, "nearer to what the map has no behaviour leads: a cell, as far as maps are right", CHOSEN, ge=0, le=1
    )
    clear_s: float = setting(0.8, "so far ahead that is looked at: it has stopped by then", CHOSEN, gt=0, le=5)


class NavigatorSettings(Settings):
    """When a plan is made anew, and when a task is given up."""

    local_m: float = setting(
        8.0, "side of the square about the robot that the controller goes by: twice its look ahead", CHOSEN, ge=3, le=40
    )
    hidden_m: float = setting(
        0.3,
        "beyond the circle that its corners go, floor that neither map nor camera knows is an obstacle to controllers, "
        "where unknown floor is costly, until no way on is found: what is farther off is looked at on the way there",
        CHOSEN,
        ge=0,
        le=2,
    )
    hidden_deep_m: float = setting(
        0.1,
        "where it lies deeper than so in such floor: cells and depth err by less. A view of 54°, which a corner of the "
        "front leads by 0.07 m, shows nothing of what that corner sweeps in a tight curve",
        "reckoned",
        ge=0,
        le=2,
    )
    hidden_known_m: float = setting(
        0.25,
        "the same of floor that the map has as free: a little less than monitor.blind_m, since the collision monitor, "
        "which knows no map, lets no part of the robot deeper into it",
        "reckoned",
        ge=0,
        le=2,
    )
    check_s: float = setting(0.5, "time between two looks whether the way ahead is still free", CHOSEN, gt=0, le=10)
    check_m: float = setting(
        3.0, "of the way ahead that is looked at: what the camera sees surely", CHOSEN, gt=0, le=20
    )
    anew_s: float = setting(1.0, "least time between two plans, while it drives", CHOSEN, gt=0, le=60)
    onward_m: float = setting(
        1.5,
        "of the way ahead that must be free for it to drive on while another plan is made: to a stop from 1 m/s, and "
        "what it drives until the plan is there",
        "reckoned",
        ge=0,
        le=20,
    )
    planning_s: float = setting(
        0.15,
        "simulated time that a plan takes, where time stands still else: of 1000 × 1000 cells",
        "issue 32",
        ge=0,
        le=10,
    )
    mapping_s: float = setting(
        0.3,
        "simulated time likewise that a floor takes whose keyframes moved: of 300 keyframes",
        "docs/occupancy.md: 1.0 s for 1000",
        ge=0,
        le=10,
    )
    jump_m: float = setting(
        0.1, "by which the map may move below the robot before it plans anew: a margin", CHOSEN, gt=0, le=5
    )
    jump_rad: float = setting(0.06, "likewise, a turn", CHOSEN, gt=0, le=3)
    held_s: float = setting(
        4.0,
        "time for which the collision monitor or the controller may hold it before it gets itself out",
        CHOSEN,
        gt=0,
        le=60,
    )
    tries: int = setting(6, "times to get itself out, without a way made, before it gives up", CHOSEN, ge=0, le=100)
    patience_s: float = setting(
        120.0,
        "time since it last made way in which it does not give up where somebody walks about: he will go",
        CHOSEN,
        ge=0,
        le=3600,
    )
    progress_m: float = setting(
        1.0, "from where it last got itself out, so far off its tries begin anew", CHOSEN, gt=0, le=20
    )
    loiter_s: float = setting(
        30.0,
        "time in which it drives and comes no farther than progress_m, before it gets itself out: a way with many "
        "turns in a narrow place takes 20 s. Plans that follow each other may lead to and fro",
        CHOSEN,
        gt=0,
        le=600,
    )
    lost_s: float = setting(
        120.0,
        "time without knowing where in the map it is, before it gives up: three whole turns, and two ways between",
        "reckoned",
        gt=0,
        le=3600,
    )
    unsure_m: float = setting(
        0.3,
        "standard deviation that a position may gain while wheels alone lead; then it stands and looks about",
        "half a robot's width",
        gt=0,
        le=5,
    )
    through_m: float = setting(
        1.5, "distance between the poses by which a recorded way is followed", CHOSEN, gt=0.2, le=20
    )


class BlockedSettings(Settings):
    """How long plans keep away from where one was found to be blocked."""

    radius_m: float = setting(0.6, "of a place, about the axle: a robot's width", CHOSEN, gt=0, le=5)
    cost: float = setting(
        4.0,
        "that a metre costs more there, in metres, for each visit that found it blocked, up to three; in a map of "
        "before but for the first: a way round of up to 15 m is taken first",
        CHOSEN,
        ge=0,
        le=100,
    )
    visit_s: float = setting(10.0, "in which it is found again at the same visit", CHOSEN, ge=0, le=600)
    seconds: float = setting(180.0, "after which it is forgotten: who stood there may have gone", CHOSEN, ge=0, le=3600)


class HoldSettings(Settings):
    """While the localization is less sure of the place in the map than it was, wheels carry the old place on."""

    sure_m: float = setting(0.05, "standard deviation of a place that is taken as it is: a cell", CHOSEN, ge=0, le=5)
    seconds: float = setting(
        3.0, "longest time: somebody who walks past fills the view for one or two", CHOSEN, ge=0, le=60
    )
    way_m: float = setting(1.0, "longest way", CHOSEN, ge=0, le=20)
    wheels_share: float = setting(0.05, "of a way, by which wheels err: one standard deviation", CHOSEN, ge=0, le=1)
    unproven_m: float = setting(
        15.0, "way on which a start that somebody said is believed though nothing is recognised", CHOSEN, gt=0, le=1000
    )


class ExplorationSettings(Settings):
    """Where a robot looks that is to see all floor it can reach."""

    least_m: float = setting(
        0.6, "width of floor that nobody has seen and that is worth a look: a robot fits in no less", CHOSEN, gt=0, le=5
    )
    least_m2: float = setting(
        0.2,
        "floor that a view must show to be driven to, m²: a third of what a wheelchair stands on",
        "found on the simulator alone: docs/decisions/0079",
        gt=0,
        le=100,
    )
    far_m: float = setting(
        3.5, "from where floor is looked at, at most: farther a Kinect's floor is rough", CHOSEN, gt=0.5, le=10
    )
    way_per_m: float = setting(
        0.5,
        "by which share a metre of way makes a view worth less: 2 m to e⁻¹. González-Baños and Latombe 2002 have 0.2; "
        "a camera of 60° has more views at one place to take first",
        "found on the simulator alone: docs/decisions/0079",
        ge=0,
        le=10,
    )
    turn_m: float = setting(
        0.4,
        "metres of way that a radian of turn costs: as long as both take over floor not seen lately, at 0.2 m/s and "
        "0.5 rad/s",
        "reckoned",
        ge=0,
        le=10,
    )
    shown: float = setting(
        0.9,
        "share of the floor that a view was to show, once seen from elsewhere, that makes it needless: the next one "
        "shows the rest",
        CHOSEN,
        gt=0,
        le=1,
    )
    tries: int = setting(2, "looks at floor that stays unseen, before it is left", CHOSEN, ge=1, le=20)
    same_m: float = setting(0.7, "places that are nearer count as one", CHOSEN, gt=0, le=5)
    same_rad: float = setting(0.5, "and directions from there: half a Kinect's view", CHOSEN, gt=0, le=3.2)
    there_m: float = setting(0.15, "from where floor is to be looked at, that is near enough", CHOSEN, ge=0, le=2)
    there_rad: float = setting(0.15, "likewise, the direction: a seventh of a Kinect's view", CHOSEN, ge=0, le=3)
    turns: int = setting(3, "looks around at the begin, in a whole turn on the spot", CHOSEN, ge=0, le=12)


class NavigationSettings(Settings):
    """How a robot drives by itself; see docs/navigation.md."""

    footprint: FootprintSettings = FootprintSettings()
    limits: RobotLimits = RobotLimits()
    navigator: NavigatorSettings = NavigatorSettings()
    behaviours: BehaviourSettings = BehaviourSettings()
    blocked: BlockedSettings = BlockedSettings()
    hold: HoldSettings = HoldSettings()
    exploration: ExplorationSettings = ExplorationSettings()
    costmap: CostmapSettings = CostmapSettings()
    live: LiveLayerSettings = LiveLayerSettings()
    people: PeopleSettings = PeopleSettings()
    planner: PlannerSettings = PlannerSettings()
    controller: Literal["mppi", "pure_pursuit"] = setting("mppi", "which controller follows plans", CHOSEN)
    follow: FollowSettings = FollowSettings()
    mppi: MppiSettings = MppiSettings()
    pure_pursuit: PurePursuitSettings = PurePursuitSettings()
    monitor: MonitorSettings = MonitorSettings()
    view: ViewSettings = ViewSettings()
    wheel_check: WheelCheckSettings = WheelCheckSettings()

    @property
    def drivable(self) -> PlannerSettings:
        """Of plans that can be driven: controllers keep a margin, and could not follow one that keeps less."""
        least_m = max(self.planner.margin_m, self.follow.margin_m)
        wanted_m = max(self.planner.wanted_margin_m, least_m)
        return self.planner.model_copy(update={"margin_m": least_m, "wanted_margin_m": wanted_m})
