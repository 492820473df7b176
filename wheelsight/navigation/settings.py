"""Settings of navigation, the robot's outline (`Footprint`), and the limits of silence of the program's parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator
from scipy.spatial.distance import cdist

from wheelsight.core.drive_model import DriveModel
from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import FloatArray
from wheelsight.core.robots import RobotLimits
from wheelsight.core.settings import CHOSEN, Settings, conflict, setting
from wheelsight.navigation.clearance_kernels import OVERHANG_M, CostField, Outline

# Limits of silence of a part of the program while the robot moves; a part that is silent for longer stops the motors.
# For camera, localization and planner. A plan takes 0.1 to 0.25 s in a flat, 0.8 s over 1000 × 1000 cells. A limit by
# the longest earlier plan let the robot drive for 0.67 s on a busy computer; 0.6 s is the most.
SILENT_S = 0.4
# Without an estimate for `COASTING_S`, wheels alone carry the pose, and the robot slows down. From then on it stops
# after `SILENT_M` of way, too.
COASTING_S, SILENT_M = 0.2, 0.25
# For the first plan, without an earlier one to compare with. The largest map takes a small computer 4 s.
FIRST_PLAN_S = 30.0
# For a grid of the floor; an hour's keyframes take a second.
FLOOR_SILENT_S = 10.0

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


class LiveLayerSettings(Settings):
    """Live layer: obstacles in the newest depth images."""

    floor_m: float = setting(
        0.05, "height above which a point is an obstacle, metres: casters climb less", _AS_OCCUPANCY, gt=0, le=1
    )
    height_m: float = setting(
        1.4, "height up to which objects are obstacles, metres", "a person who sits in a wheelchair", gt=0, le=5
    )
    far_m: float = setting(
        4.5, "range along the floor, metres: a Kinect's depth errs by 3 cm there", "calculated", gt=0, le=30
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
        0.1, "wanted clearance where there is room, metres: the error of the localization", CHOSEN, ge=0, le=1
    )
    nearness_cost: float = setting(
        1.0, "extra cost of a metre where the costmap's cost is 1; in proportion below", CHOSEN, ge=0, le=100
    )
    backward_cost: float = setting(
        4.0, "cost of a metre backward: no camera looks there, and it is slower", CHOSEN, ge=1, le=100
    )
    goal_tolerance_m: float = setting(
        0.5, "distance from an occupied goal within which a plan may end, metres", CHOSEN, ge=0, le=5
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.wanted_margin_m < self.margin_m:
            raise conflict("wanted_margin_m", "is less than margin_m", "wanted_margin_m ≥ margin_m")
        return self


class FollowSettings(Settings):
    """Path following of both controllers: clearance and arrival."""

    lag_s: float = setting(
        0.15, "time constant of the base's response to a command, besides its limits; measure it", CHOSEN, gt=0, le=1
    )
    margin_m: float = setting(
        0.04, "least distance of any command to obstacles; cells and their distances err by less", CHOSEN, ge=0, le=1
    )
    people_margin_m: float = setting(0.15, "the same for people, who may step to either side", CHOSEN, ge=0, le=2)
    goal_m: float = setting(
        0.1, "distance from the goal that is an arrival; 0.15 with the error of localization", "issue 32", gt=0, le=1
    )
    goal_rad: float = setting(0.087, "deviation from the goal's heading that is an arrival: 5°", "issue 32", gt=0, le=1)

    def of_drive(self, drive: DriveModel | None) -> FollowSettings:
        """Return the settings with the lag of a robot's drive: dead time and time constant. None changes nothing."""
        if drive is None:
            return self
        return self.model_copy(update={"lag_s": max(self.lag_s, drive.stop_s(straight=True, turn=True, sigmas=0.0))})


class MppiSettings(Settings):
    """Model predictive path integral control."""

    rollouts: int = setting(2000, "number of sampled command sequences, even", "Nav2's default", ge=16, le=100_000)


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
    coasting_m_s: float = setting(
        0.35, "speed limit while wheels alone carry the pose", "docs/fusion.md: slows down", gt=0, le=3
    )
    coasting_rad_s: float = setting(
        0.5, "turn rate limit while wheels alone carry the pose", "docs/fusion.md: slows down", gt=0, le=4
    )
    frame_age_s: float = setting(
        0.3, "age of the newest usable frame beyond which it stops: 3 frames of 10 per second", CHOSEN, gt=0, le=5
    )
    encoder_age_s: float = setting(
        0.15, "age of the newest wheel reading beyond which it stops: 3 of 20 per second", CHOSEN, gt=0, le=5
    )
    blind_m_s: float = setting(0.2, "speed onto floor that was not seen lately, and backward", CHOSEN, gt=0, le=1)
    blind_rad_s: float = setting(0.5, "turn rate over floor that was not seen lately", CHOSEN, gt=0, le=4)
    blind_m: float = setting(0.3, "depth of the outline in unseen floor at which it stops", "issue 32", ge=0, le=2)
    fresh_s: float = setting(
        12.0,
        "time for which floor counts as seen; a person who comes later is visible. A chair whose camera sees the floor "
        "from 2.3 m on takes 7.5 s at 0.2 m/s until its front is there, and longer if it waits: "
        "docs/decisions/monitor-and-safety",
        CHOSEN,
        gt=0,
        le=600,
    )


class PeopleSettings(Settings):
    """Detection and tracking of people, and their prediction for controllers."""

    is_predicted: bool = setting(
        True,
        "whether controllers get predictions of people; otherwise people are obstacles at their last place",
        CHOSEN,
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
    search_m: float = setting(
        1.5,
        "way over seen floor to the next place where a lost robot turns around; 0 to stay. Views are recognized from "
        "about this distance",
        CHOSEN,
        ge=0,
        le=10,
    )


class NavigatorSettings(Settings):
    """Navigator: when it replans, and when it gives up a task."""

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
        "time since the last progress before it gives up near people, or what the map lacks in the only way",
        CHOSEN,
        ge=0,
        le=3600,
    )
    lost_s: float = setting(
        120.0,
        "time with an unknown pose in the map before it gives up: three whole turns, and two ways between",
        "calculated",
        gt=0,
        le=3600,
    )


class NavigationSettings(Settings):
    """Navigation; see docs/navigation.md."""

    footprint: FootprintSettings = FootprintSettings()
    limits: RobotLimits = RobotLimits()
    navigator: NavigatorSettings = NavigatorSettings()
    behaviours: BehaviourSettings = BehaviourSettings()
    costmap: CostmapSettings = CostmapSettings()
    live: LiveLayerSettings = LiveLayerSettings()
    people: PeopleSettings = PeopleSettings()
    planner: PlannerSettings = PlannerSettings()
    controller: Literal["mppi", "pure_pursuit"] = setting("mppi", "which controller follows plans", CHOSEN)
    follow: FollowSettings = FollowSettings()
    mppi: MppiSettings = MppiSettings()
    monitor: MonitorSettings = MonitorSettings()

    @property
    def drivable(self) -> PlannerSettings:
        """Planner settings with the margin of the controllers, which cannot follow a plan with less."""
        least_m = max(self.planner.margin_m, self.follow.margin_m)
        wanted_m = max(self.planner.wanted_margin_m, least_m)
        return self.planner.model_copy(update={"margin_m": least_m, "wanted_margin_m": wanted_m})


# Sides of the polygon that stands for a circle.
_ROUND_SIDES = 16
# Grid of the points that the discs of an outline must cover. A coarser one needs more discs; a chair has 14.
_COVER_STEP_M = 0.02


@dataclass(frozen=True, eq=False)
class Footprint:
    """Convex outline of a robot in the frame `base`, whose origin is the centre of the axle.

    Attributes:
        corners: (N, 2) counter-clockwise, metres.
    """

    corners: FloatArray

    @classmethod
    def of(cls, corners: ArrayLike) -> Footprint:
        """Return the footprint with corners (N, 2) of a convex outline, in either order.

        Raises ArgumentError for fewer than three corners, and if they are not finite or convex, or leave out the axle.
        """
        points = np.asarray(corners, float)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3 or not np.isfinite(points).all():
            raise ArgumentError(f"a footprint of shape {points.shape}", fix="give three corners (N, 2) or more, metres")
        after = np.roll(points, -1, axis=0)
        if (points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum() < 0:
            points = points[::-1]
        sides = np.roll(points, -1, axis=0) - points
        turns = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
        if (turns <= 0).any():
            raise ArgumentError("the footprint is not convex", fix="give its convex hull")
        made = cls(points)
        if made.inscribed_m <= 0:
            raise ArgumentError(
                "the centre of rotation lies outside of the footprint", fix="give corners about the axle"
            )
        return made

    @classmethod
    def rectangle(cls, front_m: float, back_m: float, width_m: float) -> Footprint:
        """Return a rectangle with lengths ahead of the axle and behind it. Raises ArgumentError."""
        half = width_m / 2
        return cls.of([(-back_m, -half), (front_m, -half), (front_m, half), (-back_m, half)])

    @classmethod
    def circle(cls, radius_m: float) -> Footprint:
        """Return a polygon around a circle about the axle. Raises ArgumentError."""
        angles = np.arange(_ROUND_SIDES) * 2 * np.pi / _ROUND_SIDES
        return cls.of(radius_m / np.cos(np.pi / _ROUND_SIDES) * np.stack([np.cos(angles), np.sin(angles)], axis=-1))

    @property
    def inscribed_m(self) -> float:
        """Distance from the centre of rotation to the nearest side; any obstacle nearer to it collides."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        crosses = self.corners[:, 0] * sides[:, 1] - self.corners[:, 1] * sides[:, 0]
        return float((crosses / np.linalg.norm(sides, axis=1)).min())

    @property
    def circumscribed_m(self) -> float:
        """Distance to the farthest corner; without obstacles nearer to it the robot may turn in place."""
        return float(np.linalg.norm(self.corners, axis=1).max())

    def padded(self, margin_m: float) -> Footprint:
        """Return the footprint with all sides moved outward. Raises ArgumentError if nothing is left of it."""
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        normals = np.stack([sides[:, 1], -sides[:, 0]], axis=-1) / np.linalg.norm(sides, axis=1, keepdims=True)
        offsets = (normals * self.corners).sum(axis=1) + margin_m
        before_n, before_o = np.roll(normals, 1, axis=0), np.roll(offsets, 1)
        corners = [
            np.linalg.solve(np.stack([n0, n1]), np.array([o0, o1]))
            for n0, n1, o0, o1 in zip(before_n, normals, before_o, offsets, strict=True)
        ]
        return Footprint.of(corners)

    def at(self, pose: ArrayLike) -> FloatArray:
        """Return corners (..., N, 2) of a base at poses (..., 3) of x, y, yaw."""
        pose = np.asarray(pose, float)
        c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        R = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
        return np.asarray(self.corners @ np.swapaxes(R, -1, -2) + pose[..., None, :2])

    def contains(self, points: ArrayLike) -> np.ndarray:
        """Return (...,) whether points (..., 2) in `base` lie inside or on the outline."""
        points = np.asarray(points, float)
        sides = np.roll(self.corners, -1, axis=0) - self.corners
        apart = points[..., None, :] - self.corners
        return np.asarray((sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0] >= -1e-12).all(axis=-1))


def checked(field: CostField) -> CostField:
    """Return a field with the types of the kernels. Raises ArgumentError for wrong shapes or numbers."""
    distance, cost, speed = (np.ascontiguousarray(a, np.float32) for a in (field[0], field[1], field[4]))
    if distance.ndim != 2 or min(distance.shape) < 2 or cost.shape != distance.shape:
        raise ArgumentError(f"a field of shapes {distance.shape}, {cost.shape}", fix="give two of (H, W)")
    if speed.shape not in (distance.shape, (1, 1)):
        raise ArgumentError(f"speeds of zones of shape {speed.shape}", fix=f"give {distance.shape} or (1, 1)")
    numbers = np.array([field.resolution, *field.origin], float)
    if not np.isfinite(numbers).all() or field.resolution <= 0:
        raise ArgumentError(f"a field of {field.resolution} m at {field.origin}", fix="give finite metres")
    if np.isnan(distance).any() or np.isnan(cost).any() or np.isnan(speed).any():
        raise ArgumentError("a field holds NaN", fix="make unknown cells obstacles, or give them a cost")
    return CostField(distance, cost, float(numbers[0]), (float(numbers[1]), float(numbers[2])), speed)


def sides_of(footprint: Footprint) -> FloatArray:
    """Return (N, 5), the start, direction and length of each side."""
    ways = np.roll(footprint.corners, -1, axis=0) - footprint.corners
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    return np.ascontiguousarray(np.concatenate([footprint.corners, ways / lengths, lengths], axis=1))


def _inside_m(sides: FloatArray, at: FloatArray) -> FloatArray:
    """Return (...,) distances of points (..., 2) to the nearest side; negative outside."""
    apart = at[..., None, :] - sides[:, :2]
    return np.asarray((sides[:, 2] * apart[..., 1] - sides[:, 3] * apart[..., 0]).min(axis=-1))


def outline_of(footprint: Footprint) -> Outline:
    """Return the footprint as kernels use it, with discs that cover it, and exceed it by less than `OVERHANG_M`."""
    corners, sides = footprint.corners, sides_of(footprint)
    low, high = corners.min(axis=0), corners.max(axis=0)
    counts = np.maximum(np.ceil((high - low) / _COVER_STEP_M).astype(int) + 1, 2)
    axes = (np.linspace(*ends) for ends in zip(low, high, counts, strict=True))
    inside = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    on_sides = [
        corner + np.linspace(0, length, 2 + int(length / _COVER_STEP_M))[:, None] * way
        for corner, way, length in zip(sides[:, :2], sides[:, 2:4], sides[:, 4], strict=True)
    ]
    # Its own disc covers each point at least.
    points = np.concatenate([inside[_inside_m(sides, inside) >= 0], *on_sides])
    radii = np.maximum(_inside_m(sides, points), 0) + OVERHANG_M
    # Other points of the outline lie up to half a diagonal of the grid away.
    held = cdist(points, points) <= radii[:, None] - _COVER_STEP_M * np.sqrt(0.5)
    # A greedy choice: each disc covers the most points that are left.
    chosen = []
    while held.shape[1]:
        chosen.append(int(held.sum(axis=1).argmax()))
        held = held[:, ~held[chosen[-1]]]
    middle = (low + high) / 2
    radius = float(np.linalg.norm(corners - middle, axis=1).max())
    discs = np.concatenate([points[chosen], radii[chosen, None]], axis=1)
    return Outline(sides, discs, (float(middle[0]), float(middle[1]), radius))
