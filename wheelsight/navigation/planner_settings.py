"""PlannerSettings: what can be set about plans, with the reasons for the defaults."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.settings import CHOSEN, Settings, conflict, setting


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
