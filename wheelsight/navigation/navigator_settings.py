"""NavigatorSettings and NavigationSettings: when a robot plans anew, gets itself out, or gives up."""

from __future__ import annotations

from typing import Literal

from wheelsight.navigation.control_settings import FollowSettings, MppiSettings, PurePursuitSettings
from wheelsight.navigation.costmap_settings import CostmapSettings, LiveLayerSettings
from wheelsight.navigation.footprint import Footprint
from wheelsight.navigation.monitor_settings import MonitorSettings, ViewSettings, WheelCheckSettings
from wheelsight.navigation.people_settings import PeopleSettings
from wheelsight.navigation.planner_settings import PlannerSettings
from wheelsight.robot_limits import RobotLimits
from wheelsight.settings import CHOSEN, Settings, setting


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
