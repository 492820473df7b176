"""Doors that open and shut where a robot drives whose way nobody knows before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from wheelsight.geometry import FloatArray
from wheelsight.simulation.doors import DoorSettings, Leaves, is_near, swinging
from wheelsight.simulation.world import World

_STREAM = 0xD01
_LOOKS_AGAIN_S = 1.0


@dataclass(frozen=True, slots=True)
class _Move:
    """A leaf's last movement, from a share of its whole turn to another; held where it was stopped at `end_s`."""

    begin_s: float
    takes_s: float
    end_s: float
    from_share: float
    to_share: float

    def share_at(self, stamp_s: float) -> float:
        done = min(max((min(stamp_s, self.end_s) - self.begin_s) / self.takes_s, 0.0), 1.0)
        return self.from_share + (self.to_share - self.from_share) * done**3 * (10 - 15 * done + 6 * done**2)


class LiveDoors(Leaves):
    """Some of a world's leaves, which swing at times of their own while nobody is within their reach.

    A leaf into whose reach somebody comes is held where it is, and goes on to where the world has it once it can.

    Args:
        world: whose leaves they are.
        outline: of the robot where it begins.
        count: how many move; the seed chooses.
        seed: of which move and when.
        settings: how they move.

    Raises:
        ConfigError: the world has fewer leaves that have room to swing.
    """

    def __init__(
        self, world: World, outline: shapely.Polygon, count: int, seed: int, settings: DoorSettings | None = None
    ) -> None:
        super().__init__(swinging(world, count, seed))
        self._settings = settings or DoorSettings()
        self._rng = np.random.default_rng([seed, _STREAM])
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
                    self._begin(i, stamp_s)

    def _begin(self, i: int, stamp_s: float) -> None:
        share = self._moves[i].share_at(stamp_s)
        takes_s = float(self._rng.uniform(*self._settings.swing_s))
        self._moves[i] = _Move(stamp_s, takes_s, stamp_s + takes_s, share, 1.0 if share == 0.0 else 0.0)
        self._next_s[i] = stamp_s + takes_s + float(self._rng.uniform(*self._settings.rests_s))

    def turns_at(self, stamp_s: float) -> FloatArray:
        """(N,) how far each leaf is turned from where the world has it, radians, anticlockwise."""
        shares = [move.share_at(stamp_s) for move in self._moves]
        return np.array([share * board.leaf.turn_rad for share, board in zip(shares, self._boards, strict=True)])

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
