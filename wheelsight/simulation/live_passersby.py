"""People who walk where a robot drives whose way nobody knows before: they see it, and most keep away from it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.simulation import _walk_kernels as kernels
from wheelsight.simulation.outline import outline_m
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.walking import CELL_M, RADIUS_M, STEP_S, Cylinders, Ground, Walkers, starts
from wheelsight.simulation.world import World

_STREAM = 0x11FE
_KEPT_STEPS = 8  # two seconds; frames are rendered of the last tenth


@dataclass(frozen=True, slots=True)
class LivePeopleSettings:
    """How people mind a robot.

    Attributes:
        clearance_m: from its outline to their axes, which they keep while they can: as `Passersby` do. Chosen.
        least_m: the same where there is no room for that. Chosen: a hand's breadth from skin to robot.
        careless: share of them who look at their phones: they walk on as if there was no robot, until they bump into
            it. Chosen.
    """

    clearance_m: float = 0.6
    least_m: float = 0.33
    careless: float = 0.1


class LivePassersby(Cylinders):
    """Upright cylinders the size of people, who walk to and fro along the world's route and choose each step anew.

    They step where the robot is not, neither now nor, going on as it does, a step later. Nobody knows what it does
    next, so a robot that drives at somebody who has no room hits them. Who is careless walks into it.

    Args:
        world: whose route they walk and whose obstacles they go round.
        T_world_base: (4, 4) where the robot begins.
        count: how many.
        seed: of who they are.
        robot: whose outline they keep away from.
        settings: how.

    Raises:
        ConfigError: a world so narrow that there is nowhere to go.
    """

    def __init__(
        self,
        world: World,
        T_world_base: FloatArray,
        count: int,
        seed: int,
        robot: Robot,
        settings: LivePeopleSettings | None = None,
    ) -> None:
        self._settings = settings or LivePeopleSettings()
        self._ground, self._outline_m = Ground(world), outline_m(robot)
        rng = np.random.default_rng((seed, _STREAM))
        clear = self._clear_of([T_world_base], self._settings.clearance_m)
        if not clear.any():
            raise ConfigError(
                f"world {world.name} leaves no room for passers-by beside the robot", fix="--passers-by 0"
            )
        self._walkers = Walkers(self._ground, starts(self._ground, clear, T_world_base[:2, 3], count, rng), rng)
        self._is_careless = rng.random(count) < self._settings.careless
        self._steps_m: deque[FloatArray] = deque([self._ground.xy_of(self._walkers.cells)], _KEPT_STEPS)
        self._newest = 0
        super().__init__(self._steps_m[0])

    def step(self, T_world_base: FloatArray, T_world_next: FloatArray) -> None:
        """Choose where to be `STEP_S` after the last step, with the robot here, and there if it goes on as it does."""
        both = [T_world_base, T_world_next]
        minding = [self._clear_of(both, self._settings.clearance_m), self._clear_of(both, self._settings.least_m)]
        # Half of a body overlaps the outline before a careless one has noticed.
        careless = [self._clear_of([T_world_base], RADIUS_M / 2)]
        cells = self._walkers.step([careless if is_careless else minding for is_careless in self._is_careless])
        self._steps_m.append(self._ground.xy_of(cells))
        self._newest += 1

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) where their axes stand at a time up to the last step, metres; of times long ago, the oldest known."""
        before, after, share = self._around(stamp_s)
        return np.asarray(before + share * (after - before))

    def velocities_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) how fast they walk, m/s."""
        before, after, _ = self._around(stamp_s)
        return np.asarray((after - before) / STEP_S)

    def _around(self, stamp_s: float) -> tuple[FloatArray, FloatArray, float]:
        oldest = self._newest + 1 - len(self._steps_m)
        step = min(max(stamp_s / STEP_S - oldest, 0.0), len(self._steps_m) - 1.0)
        index = min(int(step), max(len(self._steps_m) - 2, 0))
        return self._steps_m[index], self._steps_m[min(index + 1, len(self._steps_m) - 1)], step - index

    def _clear_of(self, poses: list[FloatArray], distance_m: float) -> ByteArray:
        """(R, C) free cells that are not so near to the robot at any of the poses."""
        clear = self._ground.is_free.copy()
        for T in poses:
            R, xy_m = np.ascontiguousarray(T[:2, :2]), np.ascontiguousarray(T[:2, 3])
            kernels.keep_clear(clear, CELL_M, self._ground.corner_m, xy_m, R, self._outline_m, distance_m)
        return clear
