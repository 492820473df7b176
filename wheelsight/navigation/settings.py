"""Settings of navigation: navigator, costmap, planner, controllers, collision monitor and people tracking."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from wheelsight.core.robots import RobotLimits
from wheelsight.core.settings import CHOSEN, Settings, conflict, setting
from wheelsight.navigation.footprint import Footprint

_AS_OCCUPANCY = "as the occupancy map's; see docs/occupancy.md"


class CostmapSettings(Settings):
    """Cost of driving in each cell."""

    unknown: Literal["forbidden", "costly"] = setting(
        "forbidden", "whether the robot may drive over unseen floor; keep it forbidden with a person on board", CHOSEN
    )
    unknown_cost: float = setting(
        0.5, "cost of unknown floor if it is costly, as a share of the highest cost", CHOSEN, ge=0, le=1
    )
    inflation_m: float = setting(
        0.6, "distance beyond the inscribed radius up to which obstacles raise the cost, metres", CHOSEN, ge=0, le=5
    )
    decay_per_m: float = setting(
        5.0, "decrease of that cost: exp(-decay · distance); at 0.3 m a quarter is left", CHOSEN, gt=0, le=50
    )


class LiveLayerSettings(Settings):
    """Live layer: obstacles in the newest depth images."""

    size_m: float = setting(
        14.0,
        "side of the square around the robot, metres: farther than the camera sees",
        CHOSEN,
        ge=2,
        le=60,
    )
    resolution_m: float = setting(0.05, "side of a cell, metres", "what Nav2's maps have", ge=0.01, le=0.5)
    floor_m: float = setting(
        0.05, "height above which a point is an obstacle, metres: casters climb less", _AS_OCCUPANCY, gt=0, le=1
    )
    drop_m: float = setting(
        0.1, "depth below the floor at which a ray shows missing floor, metres", _AS_OCCUPANCY, gt=0, le=1
    )
    tilt_rad: float = setting(
        0.015, "addition to both per metre of distance: the mount is known to a degree", _AS_OCCUPANCY, ge=0, le=0.2
    )
    height_m: float = setting(
        1.4, "height up to which objects are obstacles, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    layer_m: float = setting(
        0.1, "height of a layer, metres: a ray below a table does not clear its top", _AS_OCCUPANCY, gt=0, le=5
    )
    far_m: float = setting(
        4.5,
        "range along the floor, metres: a Kinect's depth errs by 3 cm there",
        "calculated",
        gt=0,
        le=30,
    )
    period_s: float = setting(
        0.09,
        "least time between images that are used; the collision monitor uses all of them, and two cores have "
        "no time for more",
        CHOSEN,
        ge=0,
        le=1,
    )
    columns: int = setting(
        80,
        "columns of square blocks of pixels; each block clears as one ray, up to its nearest pixel: "
        "the same number in large images, so that they take no longer",
        CHOSEN,
        ge=8,
        le=2000,
    )
    measured: float = setting(
        0.5,
        "least share of a block's pixels with a depth to clear anything: black surfaces and glass have none",
        CHOSEN,
        ge=0,
        le=1,
    )
    passes: int = setting(
        2,
        "images that must see through a layer of a cell before its obstacle is removed: one may look past a leg "
        "of a chair; at 5 images per second that takes less than half a second",
        CHOSEN,
        ge=1,
        le=20,
    )
    standing_s: float = setting(
        2.0,
        "an obstacle younger than this may be a person who passes by: plans cross it, and controllers "
        "avoid it or wait, which takes less than a detour; a person crosses a path in 1.5 s",
        CHOSEN,
        ge=0,
        le=10,
    )
    forget_s: float = setting(
        3.0, "time after which an obstacle out of view is removed that was seen only for a moment", CHOSEN, ge=0, le=60
    )
    stays: float = setting(
        10.0,
        "factor of the time that it was seen, which is added: after 3 s it stays for half a minute",
        CHOSEN,
        ge=0,
        le=1000,
    )
    settled_s: float = setting(
        10.0,
        "an obstacle that has stood for this time is not a person who walks: a recovery removes all others, so "
        "that people who have left do not remain",
        CHOSEN,
        ge=0,
        le=600,
    )
    margin_sigmas: float = setting(
        3.0,
        "part of a ray before its end that clears nothing: these standard deviations of depth, and a cell",
        CHOSEN,
        ge=0,
        le=20,
    )


class PlannerSettings(Settings):
    """Planner: paths to a goal."""

    margin_m: float = setting(
        0.025,
        "least clearance of a plan's poses, metres; between two of them no point of the robot moves more than "
        "twice as far, so the motion between them is free, too",
        CHOSEN,
        ge=0.01,
        le=1,
    )
    wanted_margin_m: float = setting(
        0.1,
        "wanted clearance where there is room, metres: the error of the localization",
        CHOSEN,
        ge=0,
        le=1,
    )
    tight_cost: float = setting(
        4.0,
        "extra cost of a metre with the least clearance only, quadratic between that and the wanted one; "
        "a free metre costs 1",
        "80 plans in four real buildings: 1 nearer than 5 cm to anything, 7 with a cost of 2; docs/decisions/planner",
        ge=0,
        le=100,
    )
    nearness_cost: float = setting(
        1.0, "extra cost of a metre where the costmap's cost is 1; in proportion below", CHOSEN, ge=0, le=100
    )
    usual_m_s: float = setting(
        0.6, "usual speed: a metre in a slower zone costs more, in proportion to its time", CHOSEN, gt=0, le=3
    )
    turn_m: float = setting(
        0.5,
        "cost of a turn in place of 1 rad, in metres: both take half a second to a second",
        CHOSEN,
        ge=0,
        le=10,
    )
    bend_m: float = setting(0.1, "cost of a bend of 1 rad, in metres", CHOSEN, ge=0, le=10)
    backward_cost: float = setting(
        4.0, "cost of a metre backward: no camera looks there, and it is slower", CHOSEN, ge=1, le=100
    )
    switch_m: float = setting(0.5, "cost of a change between forward and backward, in metres", CHOSEN, ge=0, le=10)
    radius_m: float = setting(0.4, "least radius of curves; tighter ones become turns in place", CHOSEN, gt=0, le=5)
    headings: int = setting(
        72,
        "number of headings in the search: 5° each, which move the far end of a chair by 7 cm",
        CHOSEN,
        ge=16,
        le=360,
    )
    place_m: float = setting(
        0.1,
        "grid of places in the search, metres; half of it in narrow places",
        CHOSEN,
        gt=0.005,
        le=1,
    )
    narrow_m: float = setting(
        0.2,
        "distance of obstacles from the robot's inscribed circle below which a place is narrow, metres",
        CHOSEN,
        ge=0,
        le=5,
    )
    stride_m: float = setting(
        0.1, "length of the search's arcs, metres; at least enough to leave their cell", CHOSEN, gt=0, le=1
    )
    greed: float = setting(
        1.6,
        "factor of the heuristic; 2 is faster and nearer to walls",
        "80 plans in four real buildings: docs/decisions/planner",
        ge=1,
        le=10,
    )
    connect_m: float = setting(
        4.0, "distance to the goal below which the search tries a direct connection, metres", CHOSEN, ge=0, le=50
    )
    most_states: int = setting(
        800_000,
        "limit of time and memory of a search: 90 MB, ten seconds or more",
        "calculated",
        ge=1_000,
        le=50_000_000,
    )
    goal_tolerance_m: float = setting(
        0.5, "distance from an occupied goal within which a plan may end, metres", CHOSEN, ge=0, le=5
    )
    goal_tolerance_rad: float = setting(0.35, "the same for its heading", CHOSEN, ge=0, le=3.2)
    escape_nearer_m: float = setting(
        0.01,
        "how much nearer to an obstacle such a path may lead than the robot stands, metres; controllers follow it with "
        "follow.nearer_m",
        CHOSEN,
        ge=0,
        le=0.1,
    )
    escape_m: float = setting(
        1.2, "longest path away from an obstacle that the robot stands too near to, metres", CHOSEN, ge=0, le=3
    )
    escape_depth_m: float = setting(
        0.15,
        "largest depth of an obstacle inside the robot's outline that counts as a pose error, metres",
        CHOSEN,
        ge=0,
        le=1,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.wanted_margin_m < self.margin_m:
            raise conflict("wanted_margin_m", "is less than margin_m", "wanted_margin_m ≥ margin_m")
        return self


_KINEMATIC = "found on kinematic drives of the tests alone"


class FollowSettings(Settings):
    """Path following of both controllers: segments, turns in place, arrival."""

    period_s: float = setting(0.05, "control period", "issue 32: 20 Hz", gt=0.005, le=0.5)
    lag_s: float = setting(
        0.15, "time constant of the base's response to a command, besides its limits; measure it", CHOSEN, gt=0, le=1
    )
    spacing_m: float = setting(0.05, "spacing of points along a path", "a cell of most maps", gt=0.005, le=0.5)
    margin_m: float = setting(
        0.04,
        "least distance of any command to obstacles; cells and their distances err by less",
        CHOSEN,
        ge=0,
        le=1,
    )
    nearer_m: float = setting(
        0.02,
        "how much nearer a plan may lead that begins nearer to an obstacle than margin_m: how much a "
        "corner approaches in a turn away from a wall, and the error of following it",
        CHOSEN,
        ge=0,
        le=0.1,
    )
    people_margin_m: float = setting(0.15, "the same for people, who may step to either side", CHOSEN, ge=0, le=2)
    turn_first_rad: float = setting(
        0.8,
        "deviation from the path's heading at which a standing robot first turns in place",
        "Nav2: 0.785",
        gt=0,
        le=3,
    )
    turned_rad: float = setting(0.05, "deviation from the path's heading at which such a turn ends", CHOSEN, gt=0, le=1)
    ends_turn_rad_s2: float = setting(
        0.6,
        "deceleration toward the end of a turn in place; below what the base can do, as it lags",
        CHOSEN,
        gt=0,
        le=10,
    )
    ends_m_s2: float = setting(
        0.3,
        "deceleration toward the end of a segment; more is rough for a rider, and lag adds to it",
        CHOSEN,
        gt=0,
        le=3,
    )
    slowest_m_s: float = setting(
        0.04, "least speed of a command besides a stop: motors do not turn at less", CHOSEN, gt=0, le=0.3
    )
    slowest_rad_s: float = setting(0.06, "the same for turns in place", CHOSEN, gt=0, le=0.5)
    at_end_m: float = setting(0.01, "distance before a segment's end at which it is complete", CHOSEN, gt=0, le=0.2)
    at_yaw_rad: float = setting(0.015, "angle before a turn's end at which it is complete", CHOSEN, gt=0, le=0.2)
    goal_m: float = setting(
        0.1, "distance from the goal that is an arrival; 0.15 with the error of localization", "issue 32", gt=0, le=1
    )
    goal_rad: float = setting(0.087, "deviation from the goal's heading that is an arrival: 5°", "issue 32", gt=0, le=1)
    off_path_m: float = setting(
        1.5,
        "distance from the path beyond which a new plan is needed; detours around people are less",
        CHOSEN,
        gt=0,
        le=10,
    )
    stuck_s: float = setting(3.0, "time without progress before a robot counts as blocked", CHOSEN, gt=0, le=60)
    standing_m_s: float = setting(0.02, "speed below which a robot stands", "encoders' resolution", gt=0, le=0.2)
    standing_rad_s: float = setting(0.05, "the same for turns", "encoders' resolution", gt=0, le=0.5)

    def stands(self, forward_m_s: float, turn_rad_s: float) -> bool:
        """Return whether a robot with these speeds stands."""
        return abs(forward_m_s) <= self.standing_m_s and abs(turn_rad_s) <= self.standing_rad_s


class MppiSettings(Settings):
    """Model predictive path integral control; weights are per second of a rollout unless stated."""

    rollouts: int = setting(2000, "number of sampled command sequences, even", "Nav2's default", ge=16, le=100_000)
    steps: int = setting(
        56, "steps of a control period each: 2.8 s ahead, more than a stop takes", "Nav2's default", ge=8, le=500
    )
    seed: int = setting(20, "seed of the noise, which is drawn once", "any", ge=0, le=2**31)
    knot_steps: int = setting(
        7,
        "steps between independent draws, linear between them: white noise hardly moves a robot",
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
        "share of rollouts with three draws in all: a detour around a person turns for a second and more",
        _KINEMATIC,
        ge=0,
        le=1,
    )
    spread_m_s: float = setting(0.25, "standard deviation of sampled speeds", CHOSEN, gt=0, le=2)
    spread_rad_s: float = setting(0.5, "the same for turns", CHOSEN, gt=0, le=4)
    temperature: float = setting(
        0.2,
        "cost difference that reduces a rollout's weight to 1/e: lower follows the best, higher is smoother",
        _KINEMATIC,
        gt=0,
        le=100,
    )
    aside: float = setting(80.0, "weight of half a square metre beside the path", _KINEMATIC, ge=0, le=1e4)
    aside_m: float = setting(
        0.1, "distance from the path from which that grows linearly instead of quadratically", _KINEMATIC, gt=0, le=10
    )
    heading: float = setting(
        4.0, "weight of 1 - cosine of the deviation from the path's heading", _KINEMATIC, ge=0, le=1e4
    )
    progress: float = setting(8.0, "weight of a metre along the path, at the end", _KINEMATIC, ge=0, le=1e4)
    beyond: float = setting(200.0, "weight of a square metre beyond the segment's end", _KINEMATIC, ge=0, le=1e5)
    wrong_way: float = setting(
        20.0, "weight of a metre per second against the segment's direction", CHOSEN, ge=0, le=1e4
    )
    too_fast: float = setting(50.0, "weight of a metre per second above a zone's limit", CHOSEN, ge=0, le=1e4)
    cost: float = setting(1.0, "weight of a metre through the field's cost", CHOSEN, ge=0, le=1e4)
    near: float = setting(1.5, "weight of a metre along obstacles, whole at the margin", _KINEMATIC, ge=0, le=1e4)
    near_m: float = setting(0.3, "clearance from which obstacles count", CHOSEN, gt=0, le=2)
    people: float = setting(8.0, "weight of people, whole at their margin", CHOSEN, ge=0, le=1e4)
    people_m: float = setting(0.6, "distance from which people count: a step", CHOSEN, gt=0, le=5)
    change_forward: float = setting(1.0, "weight of a step's change of speed, (m/s)²", CHOSEN, ge=0, le=1e4)
    change_turn: float = setting(0.5, "weight of a step's change of turn, (rad/s)²", CHOSEN, ge=0, le=1e4)
    contact: float = setting(
        1000.0, "cost of coming nearer than a margin: more than everything else", "calculated", gt=0, le=1e9
    )


class PurePursuitSettings(Settings):
    """Regulated pure pursuit (Macenski et al. 2023)."""

    lookahead_s: float = setting(0.8, "time at the current speed to the lookahead point", CHOSEN, gt=0, le=5)
    least_lookahead_m: float = setting(
        0.5, "least lookahead; below it a base with lag oscillates", _KINEMATIC, gt=0.05, le=2
    )
    most_lookahead_m: float = setting(0.9, "largest lookahead", "Nav2's default", gt=0.05, le=5)
    curve_m: float = setting(
        0.9, "curve radius below which the speed decreases in proportion", "Nav2's default", gt=0, le=10
    )
    near_m: float = setting(0.2, "clearance below which the speed decreases in proportion", CHOSEN, gt=0, le=2)
    near_m_s: float = setting(0.15, "least speed by curves and clearance", CHOSEN, gt=0, le=1)
    ahead_s: float = setting(0.3, "reaction time before it brakes, for the check of the free way", CHOSEN, ge=0, le=5)
    braking_share: float = setting(
        0.5, "share of the base's braking that is assumed in front of an obstacle", CHOSEN, gt=0, le=1
    )
    step_m: float = setting(
        0.05, "spacing of the poses of an arc that are checked", "a cell of most maps", gt=0.01, le=0.5
    )


class MonitorSettings(Settings):
    """Collision monitor: when it reduces a command, and when it stops the robot."""

    margin_m: float = setting(
        0.04, "least distance to obstacles; depth at half a metre errs by less", CHOSEN, ge=0, le=1
    )
    reaction_s: float = setting(
        0.3, "reaction time from an image to braking: a frame, a period, the link, the base's lag", CHOSEN, ge=0, le=3
    )
    braking_share: float = setting(
        0.8, "share of the limits' braking that is assumed; floors are wet, batteries low", CHOSEN, gt=0, le=1
    )
    slow_zone_m: float = setting(0.2, "distance within which obstacles reduce the speed", CHOSEN, ge=0, le=3)
    slow_m_s: float = setting(0.35, "speed near obstacles within the slow-down zone", CHOSEN, gt=0, le=3)
    slow_rad_s: float = setting(0.5, "turn rate near them", CHOSEN, gt=0, le=4)
    inside_m: float = setting(0.1, "depth of a point inside the outline that stops the robot", CHOSEN, ge=0, le=1)
    coasting_m_s: float = setting(
        0.35, "speed limit while wheels alone carry the pose", "docs/fusion.md: slows down", gt=0, le=3
    )
    coasting_rad_s: float = setting(
        0.5, "turn rate limit while wheels alone carry the pose", "docs/fusion.md: slows down", gt=0, le=4
    )
    frame_age_s: float = setting(
        0.3, "age of the newest usable frame beyond which it stops: 3 frames of 10 per second", CHOSEN, gt=0, le=5
    )
    frame_way_m: float = setting(
        0.24,
        "way driven since the newest usable frame beyond which it stops: at 1 m/s a control period adds 0.05 m, and "
        "0.3 m may be driven blind",
        "issue 32",
        gt=0,
        le=5,
    )
    encoder_age_s: float = setting(
        0.15, "age of the newest wheel reading beyond which it stops: 3 of 20 per second", CHOSEN, gt=0, le=5
    )
    ahead_s: float = setting(0.05, "how far a stamp may be in the future; clocks err by less", CHOSEN, ge=0, le=1)
    seen_share: float = setting(0.3, "least share of bearings with depth in a usable frame", CHOSEN, ge=0, le=1)
    blind_m_s: float = setting(0.2, "speed onto floor that was not seen lately, and backward", CHOSEN, gt=0, le=1)
    blind_rad_s: float = setting(0.5, "turn rate over floor that was not seen lately", CHOSEN, gt=0, le=4)
    blind_m: float = setting(0.3, "depth of the outline in unseen floor at which it stops", "issue 32", ge=0, le=2)
    lead_m: float = setting(
        0.1,
        "depth of the front in unseen floor up to which the floor that it crosses counts as seen: a corner precedes "
        "the view of 60° by 0.04 m in a turn",
        "calculated",
        ge=0,
        le=1,
    )
    air_m: float = setting(
        0.5,
        "least distance from the camera at which it observes the air over unseen floor: an obstacle up to its lowest "
        "ray would be visible there. A Kinect measures nothing nearer",
        CHOSEN,
        ge=0,
        le=5,
    )
    fresh_s: float = setting(
        12.0,
        "time for which floor counts as seen; a person who comes later is visible. A chair whose camera sees the floor "
        "from 2.3 m on takes 7.5 s at 0.2 m/s until its front is there, and longer if it waits: "
        "docs/decisions/monitor-and-safety",
        CHOSEN,
        gt=0,
        le=600,
    )
    remember_s: float = setting(
        600.0,
        "longest time that an obstacle out of sight is remembered; one that has left is cleared sooner",
        CHOSEN,
        gt=0,
        le=3600,
    )
    remember_m: float = setting(
        10.0,
        "longest way of the farthest corner until then: wheels err by 1 % of it, which is 0.1 m, as inside_m",
        "calculated",
        gt=0,
        le=1000,
    )
    cell_m: float = setting(0.03, "side of the memory's cells", CHOSEN, gt=0.005, le=0.2)
    window_m: float = setting(
        6.0, "side of the memory's square around the robot; twice what a stop needs", "calculated", gt=1, le=40
    )
    history_s: float = setting(1.0, "history of wheel poses, for late frames", CHOSEN, gt=0, le=10)
    gap_s: float = setting(0.5, "gap between wheel readings that invalidates the memory", CHOSEN, gt=0, le=10)
    step_m: float = setting(
        0.02, "motion of the outline between two poses of an arc that are checked", CHOSEN, gt=0.002, le=0.2
    )


class WheelCheckSettings(Settings):
    """Detection of wheels that do not follow their commands."""

    off_m_s: float = setting(
        0.15,
        "speed error beyond what acceleration explains: a blocked wheel is off by half the speed",
        CHOSEN,
        gt=0,
        le=2,
    )
    off_rad_s: float = setting(0.3, "the same for the turn rate", CHOSEN, gt=0, le=4)
    off_s: float = setting(0.3, "time of such an error until it is a fault", "issue 32", gt=0, le=5)
    lag_s: float = setting(0.3, "longest lag of a base's response to a command", CHOSEN, ge=0, le=2)
    held_s: float = setting(
        0.2,
        "least time that a base keeps a command before it stops by itself",
        "as wheel_control.hold_s",
        gt=0,
        le=5,
    )
    watchdog_s: float = setting(0.25, "largest such time", "the firmware's watchdog: docs/serial-link.md", gt=0, le=5)
    slow_share: float = setting(0.5, "share of the limits' accelerations of the slowest base", CHOSEN, gt=0, le=1)
    fast_share: float = setting(1.5, "share of the fastest base", CHOSEN, ge=1, le=10)


class ViewSettings(Settings):
    """Depth images for the collision monitor."""

    columns: int = setting(
        64,
        "bearings of the view, at most one per two pixels of a row: 0.9° each with a Kinect",
        CHOSEN,
        ge=8,
        le=1024,
    )
    cell_m: float = setting(0.05, "side of the cells that collect pixels of an obstacle", CHOSEN, gt=0.005, le=0.5)
    pixels: int = setting(
        3, "least pixels of an obstacle in a cell: at edges single pixels are wrong", CHOSEN, ge=1, le=100
    )
    bin_m: float = setting(0.1, "bins of distance for visible floor", CHOSEN, gt=0.01, le=1)
    gap_m: float = setting(
        0.3,
        "longest gap in visible floor, beyond which floor does not count: an obstacle above a chair's step hides more",
        CHOSEN,
        gt=0,
        le=2,
    )


class PeopleSettings(Settings):
    """Detection and tracking of people, and their prediction for controllers."""

    is_predicted: bool = setting(
        True,
        "whether controllers get predictions of people; otherwise people are obstacles at their last place",
        CHOSEN,
    )
    gap_m: float = setting(
        0.4,
        "longest gap between points of one object: stepping legs, and points of a wall at a grazing angle, whose "
        "gaps move with the camera",
        CHOSEN,
        gt=0,
        le=1,
    )
    least_points: int = setting(3, "least cells of an object", CHOSEN, ge=1, le=100)
    widest_m: float = setting(1.0, "largest width of a person", CHOSEN, gt=0.2, le=3)
    body_m: float = setting(
        0.25,
        "radius of a person, of whom only the near side is visible",
        "Neufert: 0.5 m from elbow to elbow",
        gt=0.05,
        le=1,
    )
    beside_m: float = setting(
        0.15,
        "distance to an obstacle of the map within which an object is that obstacle: the error of a pose",
        CHOSEN,
        ge=0,
        le=1,
    )
    sigma_m: float = setting(
        0.05, "standard deviation of an object's centre: half the swing of arms", CHOSEN, gt=0, le=1
    )
    sigma_rad: float = setting(
        0.01, "the same across, per metre of distance: the heading of a frame's pose", CHOSEN, ge=0, le=0.2
    )
    walk_m_s: float = setting(1.0, "prior standard deviation of a speed: a walk", CHOSEN, gt=0, le=5)
    change_m2_s3: float = setting(
        0.1,
        "growth of the variance of a speed per second: people keep their speed for some seconds",
        CHOSEN,
        gt=0,
        le=10,
    )
    gate: float = setting(0.99, "quantile of χ² of the gate between an observation and a track", CHOSEN, gt=0.5, lt=1)
    sure: float = setting(0.99, "quantile of χ² beyond which a speed is significant", CHOSEN, gt=0.5, lt=1)
    least_m_s: float = setting(0.3, "least speed of a walk", CHOSEN, ge=0, le=2)
    frames: int = setting(
        5, "frames with an object before it may count as a person: half a second of a Kinect", CHOSEN, ge=3, le=50
    )
    way_m: float = setting(
        0.2, "least motion in these frames: shapes shift by less with the point of view", CHOSEN, ge=0, le=2
    )
    unseen_s: float = setting(1.0, "time out of sight after which a track ends", "issue 32", gt=0, le=10)
    trail_s: float = setting(
        1.0,
        "time back along a person's path that is removed from the costmap: as long as the detection takes; "
        "no image from nearby sees through the heights that were seen from afar",
        "calculated",
        ge=0,
        le=5,
    )
    trail_m: float = setting(
        0.15, "margin around a person's circle that is removed: cells and errors", CHOSEN, ge=0, le=1
    )


class FootprintSettings(Settings):
    """Outline of the robot: a rectangle around the centre of its axle."""

    front_m: float = setting(0.8, "distance from the axle to the front", "Trinh, section II: 1.10 m", gt=0, le=5)
    back_m: float = setting(0.3, "distance from the axle to the back", "Trinh, section II", gt=0, le=5)
    width_m: float = setting(0.6, "width of the robot", "Trinh, section II", gt=0, le=5)

    @property
    def outline(self) -> Footprint:
        """The footprint for planner, controllers and collision monitor."""
        return Footprint.rectangle(self.front_m, self.back_m, self.width_m)


class BehaviourSettings(Settings):
    """Recovery behaviours."""

    wait_s: float = setting(3.0, "time to wait for a person to step aside", CHOSEN, ge=0, le=60)
    round_times: float = setting(
        1.5,
        "factor: a robot waits before a detour longer than this times the rest of the old path, plus round_m",
        CHOSEN,
        ge=1,
        le=100,
    )
    round_m: float = setting(
        1.0, "the addition to it: the way that a wait takes at walking speed among people", CHOSEN, ge=0, le=100
    )
    look_rad: float = setting(
        1.0, "turn to either side to look around; the view of a Kinect is 1 rad wide", CHOSEN, gt=0, le=3.2
    )
    search_rad: float = setting(6.4, "turn of a lost robot to find its pose: once around", CHOSEN, gt=0, le=20)
    search_m: float = setting(
        1.5,
        "way to the next place of such a turn, over seen floor; 0 to stay. Views are "
        "recognized from about this distance",
        CHOSEN,
        ge=0,
        le=10,
    )
    least_search_m: float = setting(0.5, "least such way; less shows nothing new", CHOSEN, gt=0, le=10)
    search_m_s: float = setting(0.2, "its speed", CHOSEN, gt=0, le=0.5)
    turn_rad_s: float = setting(0.4, "turn rate of such turns; images blur beyond", CHOSEN, gt=0, le=2)
    back_m: float = setting(0.3, "way back, without a camera", CHOSEN, gt=0, le=1)
    unseen_back_m: float = setting(
        0.8,
        "way back from unseen floor: a chair's camera, 0.35 m ahead of the axle, observes floor from "
        "0.5 m on, where the front was",
        "calculated",
        gt=0,
        le=3,
    )
    back_m_s: float = setting(0.1, "its speed", CHOSEN, gt=0, le=0.5)
    refused_s: float = setting(
        2.0, "time that the collision monitor may hold a behaviour before it ends", CHOSEN, gt=0, le=60
    )
    clear_m: float = setting(
        0.05, "least distance of a behaviour to obstacles of the map: a cell, the error of maps", CHOSEN, ge=0, le=1
    )
    clear_s: float = setting(0.8, "time ahead that is checked: the robot has stopped by then", CHOSEN, gt=0, le=5)


class NavigatorSettings(Settings):
    """Navigator: when it replans, and when it gives up a task."""

    local_m: float = setting(
        8.0, "side of the controller's costmap around the robot: twice its lookahead", CHOSEN, ge=3, le=40
    )
    hidden_m: float = setting(
        0.3,
        "distance beyond the circle of its corners within which floor unknown to map and camera is an obstacle to "
        "controllers, if unknown floor is costly, unless no other path exists: floor farther away becomes visible on "
        "the way",
        CHOSEN,
        ge=0,
        le=2,
    )
    hidden_deep_m: float = setting(
        0.1,
        "depth in such floor from which it counts: cells and depth err by less. A view of 54°, which a corner of the "
        "front precedes by 0.07 m, does not show what that corner sweeps in a tight curve",
        "calculated",
        ge=0,
        le=2,
    )
    hidden_known_m: float = setting(
        0.25,
        "the same for floor that is free in the map: slightly less than monitor.blind_m, as the collision monitor, "
        "which knows no map, lets no part of the robot deeper into it",
        "calculated",
        ge=0,
        le=2,
    )
    check_s: float = setting(0.5, "time between checks of the path ahead", CHOSEN, gt=0, le=10)
    check_m: float = setting(
        3.0, "length of the path ahead that is checked: what the camera sees reliably", CHOSEN, gt=0, le=20
    )
    anew_s: float = setting(1.0, "least time between plans while it drives", CHOSEN, gt=0, le=60)
    onward_m: float = setting(
        1.5,
        "length of the path ahead that must be free to drive on while a new plan is computed: a stop from 1 m/s, and "
        "the way until the plan is ready",
        "calculated",
        ge=0,
        le=20,
    )
    planning_s: float = setting(
        0.15,
        "simulated duration of a plan over 1000 × 1000 cells, as simulated time stops meanwhile",
        "issue 32",
        ge=0,
        le=10,
    )
    mapping_s: float = setting(
        0.3,
        "simulated duration of a floor after 300 keyframes moved",
        "docs/occupancy.md: 1.0 s for 1000",
        ge=0,
        le=10,
    )
    jump_m: float = setting(
        0.1, "motion of the map below the robot that requires a new plan: a margin", CHOSEN, gt=0, le=5
    )
    jump_rad: float = setting(0.06, "the same for a turn", CHOSEN, gt=0, le=3)
    held_s: float = setting(
        4.0,
        "time that the collision monitor or the controller may hold the robot before it recovers",
        CHOSEN,
        gt=0,
        le=60,
    )
    tries: int = setting(6, "recoveries without progress before it gives up", CHOSEN, ge=0, le=100)
    patience_s: float = setting(
        120.0,
        "time since the last progress before it gives up near people, who will leave",
        CHOSEN,
        ge=0,
        le=3600,
    )
    progress_m: float = setting(1.0, "distance from the last recovery that is progress", CHOSEN, gt=0, le=20)
    loiter_s: float = setting(
        30.0,
        "time without such progress before it recovers: a path with many "
        "turns in a narrow place takes 20 s. Consecutive plans may lead to and fro",
        CHOSEN,
        gt=0,
        le=600,
    )
    lost_s: float = setting(
        120.0,
        "time with an unknown pose in the map before it gives up: three whole turns, and two ways between",
        "calculated",
        gt=0,
        le=3600,
    )
    unsure_m: float = setting(
        0.3,
        "growth of a position's standard deviation by wheels alone at which it stops and looks around",
        "half a robot's width",
        gt=0,
        le=5,
    )
    through_m: float = setting(
        1.5, "distance between the poses of a recorded path that are followed", CHOSEN, gt=0.2, le=20
    )


class BlockedSettings(Settings):
    """Places where a plan was blocked, and which later plans avoid for a while."""

    radius_m: float = setting(0.6, "radius of a place around the axle: a robot's width", CHOSEN, gt=0, le=5)
    cost: float = setting(
        4.0,
        "extra cost of a metre there per visit that found it blocked, up to three; in a map of an earlier "
        "session not for the first one: a detour of up to 15 m is cheaper",
        CHOSEN,
        ge=0,
        le=100,
    )
    visit_s: float = setting(10.0, "time within which it counts as the same visit", CHOSEN, ge=0, le=600)
    seconds: float = setting(
        180.0, "time after which a visit expires: a person there may have left", CHOSEN, ge=0, le=3600
    )


class HoldSettings(Settings):
    """Hold of the pose by wheels, while the localization is less certain than it was."""

    sure_m: float = setting(0.05, "standard deviation of an estimate that is used as it is: a cell", CHOSEN, ge=0, le=5)
    seconds: float = setting(
        3.0, "longest time: a person who passes fills the view for one or two seconds", CHOSEN, ge=0, le=60
    )
    way_m: float = setting(1.0, "longest way", CHOSEN, ge=0, le=20)
    wheels_share: float = setting(
        0.05, "error of wheels, as a share of the way: one standard deviation", CHOSEN, ge=0, le=1
    )
    unproven_m: float = setting(
        15.0, "way on which a start pose from the user is valid although nothing is recognized", CHOSEN, gt=0, le=1000
    )


class ExplorationSettings(Settings):
    """Exploration of all reachable floor."""

    least_m: float = setting(
        0.6, "least width of unseen floor that is worth a look: a robot needs as much", CHOSEN, gt=0, le=5
    )
    least_m2: float = setting(
        0.2,
        "least unseen floor of a viewpoint, m²: a third of a wheelchair's area",
        "found on the simulator alone: docs/decisions/planner",
        gt=0,
        le=100,
    )
    far_m: float = setting(
        3.5,
        "largest distance at which floor counts as visible: a Kinect's floor is rough beyond",
        CHOSEN,
        gt=0.5,
        le=10,
    )
    way_per_m: float = setting(
        0.5,
        "discount of a viewpoint's value per metre of way: e⁻¹ at 2 m. González-Baños and Latombe 2002 have 0.2; "
        "a camera of 60° has more views at one place",
        "found on the simulator alone: docs/decisions/planner",
        ge=0,
        le=10,
    )
    turn_m: float = setting(
        0.4,
        "cost of a radian of turn in metres: the same time over floor not seen lately, at 0.2 m/s and 0.5 rad/s",
        "calculated",
        ge=0,
        le=10,
    )
    shown: float = setting(
        0.9,
        "share of a viewpoint's floor that makes it unnecessary once it was seen from elsewhere: the next one "
        "shows the rest",
        CHOSEN,
        gt=0,
        le=1,
    )
    tries: int = setting(2, "looks at floor that stays unseen before it is given up", CHOSEN, ge=1, le=20)
    same_m: float = setting(0.7, "distance below which places count as one", CHOSEN, gt=0, le=5)
    same_rad: float = setting(0.5, "the same for directions: half a Kinect's view", CHOSEN, gt=0, le=3.2)
    there_m: float = setting(0.15, "distance from a viewpoint that is near enough", CHOSEN, ge=0, le=2)
    there_rad: float = setting(0.15, "the same for the direction: a seventh of a Kinect's view", CHOSEN, ge=0, le=3)
    turns: int = setting(3, "looks in a whole turn in place at the start", CHOSEN, ge=0, le=12)


class NavigationSettings(Settings):
    """Navigation; see docs/navigation.md."""

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
        """Planner settings with the margin of the controllers, which cannot follow a plan with less."""
        least_m = max(self.planner.margin_m, self.follow.margin_m)
        wanted_m = max(self.planner.wanted_margin_m, least_m)
        return self.planner.model_copy(update={"margin_m": least_m, "wanted_margin_m": wanted_m})
