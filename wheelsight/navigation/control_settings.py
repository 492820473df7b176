"""Settings of controllers: how a path is followed, and what MPPI and pure pursuit go by."""

from __future__ import annotations

from wheelsight.settings import CHOSEN, Settings, setting

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
