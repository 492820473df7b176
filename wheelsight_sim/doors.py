"""`Doors` swing along a finished drive, `LiveDoors` during a commanded one; both stay clear of robot and people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import BoolArray, FloatArray
from wheelsight_sim.people import RADIUS_M, Passersby
from wheelsight_sim.robot import Drive, RobotModel, outline_at
from wheelsight_sim.world import Leaf, World

_STREAM = 0xD00
_STEP_S = 0.1  # sampling period of the robot's path, 12 cm at 1.2 m/s
_STEP_RAD = math.radians(5.0)
# Parts of a leaf beside its hinge and its free end, where wall and jamb are close by design.
_AT_HINGE_M, _AT_END_M = 0.15, 0.06
_OVER_FLOOR_M = 0.02


@dataclass(frozen=True, slots=True)
class DoorSettings:
    """Motion of doors.

    Attributes:
        swing_s: (quickest, slowest) time that a leaf takes from one end to the other. Chosen; door closers are set to
            3 to 7 s (EN 1154), hands are quicker.
        rests_s: (shortest, longest) time between two swings of a leaf, in seconds. Chosen: short, so that a drive of a
            minute meets some.
        clearance_m: distance of robot and people from the swept area of a leaf that is not at rest. Chosen.
    """

    swing_s: tuple[float, float] = (0.5, 2.0)
    rests_s: tuple[float, float] = (3.0, 15.0)
    clearance_m: float = 0.3


@dataclass(frozen=True, slots=True)
class Swing:
    """One swing of a leaf from its position in the world (0) to the other end (1), or back.

    Attributes:
        begin_s, end_s: times of its begin and end.
        to_share: its final position, 0 or 1.
    """

    begin_s: float
    end_s: float
    to_share: float


class Leaves:
    """Swinging leaves of doors; subclasses give their angles."""

    def __init__(self, boards: list[DoorPanel]) -> None:
        self._boards = boards

    @property
    def leaves(self) -> tuple[Leaf, ...]:
        """The swinging leaves."""
        return tuple(board.leaf for board in self._boards)

    def shares_at(self, stamp_s: float) -> list[float]:
        """How far each leaf is from where the world has it, 0, to its other end, 1."""
        raise NotImplementedError

    def turns_at(self, stamp_s: float) -> FloatArray:
        """(N,) how far each leaf is turned from where the world has it, radians, anticlockwise."""
        shares = zip(self.shares_at(stamp_s), self._boards, strict=True)
        return np.array([share * board.leaf.turn_rad for share, board in shares])

    def poses_at(self, stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """Middles (N, 3) of the leaves at a time, metres, and their yaws (N,), radians."""
        turned = [board.turned(turn) for board, turn in zip(self._boards, self.turns_at(stamp_s), strict=True)]
        return np.array([middle for middle, _ in turned]), np.array([yaw_rad for _, yaw_rad in turned])

    def add_to(self, spec: Any, *, is_solid: bool = False) -> None:
        """Add the leaves to a MuJoCo MjSpec as mocap bodies that replace the geoms of the same names.

        Solid ones collide with a conaffinity of 2, which the hull of a wheelchair has and walls do not.
        """
        import mujoco

        for board in self._boards:
            name, geom = board.leaf.geom, spec.geom(board.leaf.geom)
            material = geom.material
            spec.delete(geom)
            body = spec.worldbody.add_body(name=name, mocap=True, pos=board.middle_m.tolist())
            size, kind = board.half_m.tolist(), mujoco.mjtGeom.mjGEOM_BOX
            body.add_geom(name=name, type=kind, size=size, material=material, contype=2 * is_solid, conaffinity=0)


class Doors(Leaves):
    """Leaves that swing at random times along a finished drive.

    While robot or people are within reach of a leaf, it rests at its position in the world, which is out of the way:
    open where the route leads through. A swing has minimum jerk (Flash & Hogan, J. Neuroscience 5, 1985).

    The seed chooses which `count` leaves swing, and when.

    Raises:
        ConfigError: the world has fewer leaves with room to swing.
    """

    def __init__(
        self,
        world: World,
        drive: Drive,
        count: int,
        seed: int,
        robot: RobotModel | None = None,
        passersby: Passersby | None = None,
        settings: DoorSettings | None = None,
    ) -> None:
        settings = settings or DoorSettings()
        super().__init__(swinging(world, count, seed))
        start_s, end_s = (float(stamp_s) for stamp_s in drive.truth.stamps_s[[0, -1]])
        times_s = np.minimum(start_s + _STEP_S * np.arange(math.ceil((end_s - start_s) / _STEP_S) + 1), end_s)
        shape = robot or RobotModel()
        outlines = [outline_at(shape, T) for T in drive.truth.at(times_s)]
        people = [
            shapely.MultiPoint(() if passersby is None else passersby.positions_at(float(time_s))) for time_s in times_s
        ]
        rng = np.random.default_rng([seed, _STREAM, 1])
        self.starts, self.swings = [], []
        for board in self._boards:
            is_busy = is_near(board.swept(), outlines, people, settings.clearance_m)
            start, swings = _swings(times_s, is_busy, settings, rng)
            self.starts.append(start)
            self.swings.append(swings)

    def shares_at(self, stamp_s: float) -> list[float]:
        """How far each leaf is from where the world has it, 0, to its other end, 1."""
        shares = list(self.starts)
        for k, swings in enumerate(self.swings):
            for swing in swings:
                if stamp_s < swing.begin_s:
                    break
                done = min((stamp_s - swing.begin_s) / (swing.end_s - swing.begin_s), 1.0)
                shares[k] += (swing.to_share - shares[k]) * done**3 * (10 - 15 * done + 6 * done**2)
        return shares

    def to_csv(self) -> str:
        """The swings of each leaf, with angles relative to truth/world.xml."""
        lines = ["leaf,begin_s,end_s,from_deg,to_deg"]
        for board, start, swings in zip(self._boards, self.starts, self.swings, strict=True):
            turn_deg, share = math.degrees(board.leaf.turn_rad), start
            # A leaf that starts at its other end gets a swing before the drive.
            rows = [Swing(0.0, 0.0, start), *swings]
            for swing in rows:
                turns = f"{share * turn_deg + 0.0:.2f},{swing.to_share * turn_deg + 0.0:.2f}"
                lines.append(f"{board.leaf.geom},{swing.begin_s:.4f},{swing.end_s:.4f},{turns}")
                share = swing.to_share
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, eq=False)
class DoorPanel:
    """A leaf with its box at rest: middle (3,), half lengths (3,), and yaw."""

    leaf: Leaf
    middle_m: FloatArray
    half_m: FloatArray
    yaw_rad: float

    def turned(self, turn_rad: float) -> tuple[FloatArray, float]:
        """Middle (3,) and yaw once it is turned about its hinge."""
        c, s = math.cos(turn_rad), math.sin(turn_rad)
        hinge = np.array(self.leaf.hinge_m)
        x, y = self.middle_m[:2] - hinge
        return np.array([hinge[0] + c * x - s * y, hinge[1] + s * x + c * y, self.middle_m[2]]), self.yaw_rad + turn_rad

    def covers(self, turn_rad: float) -> shapely.Polygon:
        """The area that it covers at an angle about its hinge."""
        return self._footprint(*self.turned(turn_rad), 0.0, 0.0)

    def swept(self, at_hinge_m: float = 0.0, at_end_m: float = 0.0) -> shapely.Geometry:
        """The area that it sweeps, without a length at its hinge and at its end."""
        steps = max(math.ceil(abs(self.leaf.turn_rad) / _STEP_RAD), 1)
        turns = self.leaf.turn_rad * np.linspace(0, 1, steps + 1)
        places = [self._footprint(*self.turned(float(turn)), at_hinge_m, at_end_m) for turn in turns]
        return shapely.union_all([shapely.MultiPolygon(pair).convex_hull for pair in pairwise(places)])

    def _footprint(self, middle: FloatArray, yaw_rad: float, at_hinge_m: float, at_end_m: float) -> shapely.Polygon:
        along = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
        if (np.array(self.leaf.hinge_m) - middle[:2]) @ along > 0:
            along = -along
        begin = middle[:2] - (self.half_m[0] - at_hinge_m) * along
        end = middle[:2] + (self.half_m[0] - at_end_m) * along
        return shapely.LineString([begin, end]).buffer(self.half_m[1], cap_style="flat")


def swinging(world: World, count: int, seed: int) -> list[DoorPanel]:
    """`count` of a world's leaves with room to swing, chosen by seed.

    Raises:
        ConfigError: there are fewer.
    """
    boards = _boards(world) if count else []
    rng = np.random.default_rng([seed, _STREAM, 0])
    found: list[DoorPanel] = []
    for k in rng.permutation(len(boards)):
        swept = boards[k].swept()
        if all(shapely.disjoint(swept, other.swept()) for other in found):
            found.append(boards[k])
    if len(found) < count:
        problem = f"--doors is {count}; in world {world.name} there is room for {len(found)} to swing"
        raise ConfigError(problem, fix=f"0 to {len(found)}" if found else "choose flat, or a --plan with doorways")
    return found[:count]


def _boards(world: World) -> list[DoorPanel]:
    """The world's leaves, but for those that would swing into something."""
    from wheelsight_sim.clearance import footprints

    if not world.leaves:
        return []
    model, data = world.at_rest()
    things = footprints(world)
    boards = []
    for leaf in world.leaves:
        g = model.geom(leaf.geom).id
        R = data.geom_xmat[g].reshape(3, 3)
        yaw_rad = math.atan2(R[1, 0], R[0, 0])
        board = DoorPanel(leaf, data.geom_xpos[g].copy(), model.geom_size[g].copy(), yaw_rad)
        top_m = board.middle_m[2] + board.half_m[2] - _OVER_FLOOR_M
        near = [thing for thing in things if thing.top_m > _OVER_FLOOR_M and thing.bottom_m < top_m]
        others = [thing.polygon for thing in near if thing.name != leaf.geom]
        if shapely.disjoint(board.swept(_AT_HINGE_M, _AT_END_M), others).all():
            boards.append(board)
    return boards


def is_near(
    swept: shapely.Geometry, outlines: list[shapely.Polygon], people: list[shapely.Geometry], clearance_m: float
) -> BoolArray:
    """(N,) whether robot or people are too near to the swept area of a leaf."""
    shapely.prepare(swept)
    near_robot = shapely.dwithin(outlines, swept, clearance_m)
    return np.asarray(near_robot | shapely.dwithin(people, swept, RADIUS_M + clearance_m), bool)


def _swings(
    times_s: FloatArray, is_busy: BoolArray, settings: DoorSettings, rng: np.random.Generator
) -> tuple[float, tuple[Swing, ...]]:
    """The initial position and the swings of a leaf: it returns before its area is busy, and rests until it is free."""
    edges = np.flatnonzero(np.diff(is_busy)) + 1
    parts = [part for part in np.split(np.arange(len(times_s)), edges) if not is_busy[part[0]]]
    start, swings = 0.0, list[Swing]()
    for part in parts:
        now_s, until_s = float(times_s[part[0]]), float(times_s[part[-1]])
        is_last = part[-1] == len(times_s) - 1
        share = 0.0
        if part[0] == 0:
            # Some leaves start at their other end.
            is_away = bool(rng.random() < 0.5) and (is_last or until_s - now_s > settings.swing_s[1])
            start = share = float(is_away)
        while True:
            begin_s = now_s + float(rng.uniform(*settings.rests_s))
            takes_s = float(rng.uniform(*settings.swing_s))
            # A leaf at its other end must return in time, and a leaf that leaves needs time to return.
            latest_s = until_s if is_last else until_s - (0.0 if share else settings.rests_s[0] + settings.swing_s[1])
            if share and not is_last:
                begin_s = min(begin_s, until_s - settings.swing_s[1])
            if begin_s + takes_s > latest_s:
                break
            share, now_s = 1.0 - share, begin_s + takes_s
            swings.append(Swing(begin_s, now_s, share))
    return start, tuple(swings)


_LIVE_DOORS_STREAM = 0xD01
_LOOKS_AGAIN_S = 1.0


@dataclass(frozen=True, slots=True)
class _Move:
    """The last movement of a leaf between two positions, 0 to 1; it is held where it stopped at `end_s`."""

    begin_s: float
    takes_s: float
    end_s: float
    from_share: float
    to_share: float

    def share_at(self, stamp_s: float) -> float:
        done = min(max((min(stamp_s, self.end_s) - self.begin_s) / self.takes_s, 0.0), 1.0)
        return self.from_share + (self.to_share - self.from_share) * done**3 * (10 - 15 * done + 6 * done**2)


class LiveDoors(Leaves):
    """Leaves that swing at random times during a commanded drive, while robot and people are out of reach.

    A leaf stops when robot or people come within reach, and later returns to its position in the world.

    The seed chooses which `count` leaves swing, and when; `outline` is the robot's at its start.

    Raises:
        ConfigError: the world has fewer leaves with room to swing.
    """

    def __init__(
        self, world: World, outline: shapely.Polygon, count: int, seed: int, settings: DoorSettings | None = None
    ) -> None:
        super().__init__(swinging(world, count, seed))
        self._settings = settings or DoorSettings()
        self._rng = np.random.default_rng([seed, _LIVE_DOORS_STREAM])
        self._swept = [board.swept() for board in self._boards]
        is_away = self._rng.random(count) < 0.5
        for i, swept in enumerate(self._swept):
            is_away[i] &= not is_near(swept, [outline], [shapely.MultiPoint()], self._settings.clearance_m)[0]
        self._moves = [_Move(-1.0, 1.0, 0.0, share, share) for share in is_away.astype(float).tolist()]
        self._next_s = self._rng.uniform(*self._settings.rests_s, count).tolist()

    def step(self, stamp_s: float, outline: shapely.Polygon, people_m: FloatArray) -> None:
        """Begin, hold or end movements, with the robot and people (N, 2) as they stand now."""
        people = shapely.MultiPoint(people_m)
        for i, swept in enumerate(self._swept):
            is_busy = bool(is_near(swept, [outline], [people], self._settings.clearance_m)[0])
            move = self._moves[i]
            if stamp_s < move.end_s and is_busy:
                share = move.share_at(stamp_s)
                self._moves[i] = _Move(move.begin_s, move.takes_s, stamp_s, move.from_share, move.to_share)
                self._next_s[i] = stamp_s + _LOOKS_AGAIN_S if 0 < share < 1 else self._next_s[i]
            elif stamp_s >= max(move.end_s, self._next_s[i]):
                self._next_s[i] = stamp_s + _LOOKS_AGAIN_S
                if not is_busy:
                    share = self._moves[i].share_at(stamp_s)
                    takes_s = float(self._rng.uniform(*self._settings.swing_s))
                    self._moves[i] = _Move(stamp_s, takes_s, stamp_s + takes_s, share, 1.0 if share == 0.0 else 0.0)
                    self._next_s[i] = stamp_s + takes_s + float(self._rng.uniform(*self._settings.rests_s))

    def shares_at(self, stamp_s: float) -> list[float]:
        """How far each leaf is from where the world has it, 0, to its other end, 1."""
        return [move.share_at(stamp_s) for move in self._moves]

    def places_at(self, stamp_s: float) -> list[shapely.Polygon]:
        """What each leaf covers of the floor."""
        turns = self.turns_at(stamp_s)
        return [board.covers(float(turn)) for board, turn in zip(self._boards, turns, strict=True)]

    def velocity_at(self, index: int, place_m: FloatArray, stamp_s: float) -> FloatArray:
        """(2,) how fast a leaf moves at a place (2,) of it, m/s."""
        step_s = 1e-3
        turn_rad_s = float((self.turns_at(stamp_s + step_s) - self.turns_at(stamp_s))[index]) / step_s
        x, y = place_m - np.array(self._boards[index].leaf.hinge_m)
        return turn_rad_s * np.array([-y, x])
