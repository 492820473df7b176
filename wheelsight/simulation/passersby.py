"""People who walk to and fro along a route while the robot drives it, and keep out of the robot's way."""

from __future__ import annotations

import math
import zlib

import cv2
import numpy as np

from wheelsight.errors import ConfigError
from wheelsight.geometry import ByteArray, FloatArray
from wheelsight.simulation import _walk_kernels as kernels
from wheelsight.simulation.drive import Drive
from wheelsight.simulation.outline import outline_m
from wheelsight.simulation.robot import Robot
from wheelsight.simulation.walking import (
    CELL_M,
    STEP_S,
    Cylinders,
    Ground,
    Walkers,
    reach_cells,
    starts,
    steps_within_reach,
)
from wheelsight.simulation.world import World

CLEARANCE_M = 0.6

# Between two steps both go on straight, which can bring them nearer than at either end.
_MARGIN_M = 0.1
_STREAM = 0x9A55


class Passersby(Cylinders):
    """Upright cylinders the size of people, walking to and fro along the world's route at 0.8 to 1.3 m/s.

    The drive is known before they walk. Going back from its end, all places are found from which somebody can still
    get out of the robot's way: those that are clear now, with one within a step that will be. Walkers choose among
    these only, so that they step aside, wait or turn back in time. Their axes stay at least 0.6 m from the robot's
    outline and 0.3 m from what stands in the world; from each other they keep away where they can.

    Args:
        world: whose route they walk and whose obstacles they go round.
        drive: finished; they have walked since its first pose and stand still after its last.
        count: how many.
        seed: of where they begin, how fast they walk and when they turn back.
        robot: whose outline they keep away from.

    Raises:
        ConfigError: a negative count, or a world so narrow that there is nowhere to go.
    """

    def __init__(self, world: World, drive: Drive, count: int, seed: int, robot: Robot | None = None) -> None:
        if count < 0:
            raise ConfigError(f"{count} passers-by", fix="0 or more")
        self._start_s = float(drive.truth.stamps_s[0])
        self._xy_m = np.zeros((1, 0, 2))
        if count:
            robot = robot or Robot()
            times_s = np.arange(math.ceil(drive.duration_s / STEP_S) + 1) * STEP_S + self._start_s
            T = drive.truth.at(times_s.clip(None, drive.truth.stamps_s[-1]))
            ground = Ground(world)
            safe = _safe_cells(ground, T, outline_m(robot), world.name)
            self._xy_m = _walk(ground, safe, T[0, :2, 3], count, np.random.default_rng((seed, _STREAM)))
        super().__init__(self._xy_m[0])

    def positions_at(self, stamp_s: float) -> FloatArray:
        """(N, 2) where their axes stand at a time in seconds; before and after the drive, where they begin and end."""
        step = min(max((stamp_s - self._start_s) / STEP_S, 0.0), len(self._xy_m) - 1.0)
        before = int(step)
        after = min(before + 1, len(self._xy_m) - 1)
        return np.asarray(self._xy_m[before] + (step - before) * (self._xy_m[after] - self._xy_m[before]))


class _SafeCells:
    """Which cells (R, C) are safe at each step; kept as what differs from the free ones, which is little."""

    def __init__(self, is_free: ByteArray) -> None:
        self._is_free, self._packed = is_free, list[bytes]()

    def __len__(self) -> int:
        return len(self._packed)

    def put_before(self, safe: ByteArray) -> None:
        """Add the step before those there are."""
        self._packed.append(zlib.compress(np.packbits(safe ^ self._is_free).tobytes(), 1))

    def at(self, step: int) -> ByteArray:
        """(R, C) uint8."""
        bits = np.frombuffer(zlib.decompress(self._packed[-1 - step]), np.uint8)
        return np.unpackbits(bits, count=self._is_free.size).reshape(self._is_free.shape) ^ self._is_free


def _safe_cells(ground: Ground, T_world_robot: FloatArray, reach_m: FloatArray, world: str) -> _SafeCells:
    """Cells from which the robot at poses (N, 4, 4), a step apart, can be avoided until the last of them."""
    reach = np.zeros((2 * reach_cells() + 1,) * 2, np.uint8)
    reach[tuple((steps_within_reach() + reach_cells()).T)] = 1
    cells, safe = _SafeCells(ground.is_free), ground.is_free
    for T in T_world_robot[::-1]:
        near_safe = cv2.dilate(safe, reach, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        safe = np.where(near_safe, ground.is_free, np.uint8(0))
        R, xy_m = np.ascontiguousarray(T[:2, :2]), np.ascontiguousarray(T[:2, 3])
        kernels.keep_clear(safe, CELL_M, ground.corner_m, xy_m, R, reach_m, CLEARANCE_M + _MARGIN_M)
        cells.put_before(safe)
    if not safe.any():
        raise ConfigError(f"world {world} leaves no room for passers-by beside the robot", fix="--passers-by 0")
    return cells


def _walk(ground: Ground, safe: _SafeCells, xy_robot_m: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """(N, count, 2) positions, a step apart."""
    walkers = Walkers(ground, starts(ground, safe.at(0), xy_robot_m, count, rng), rng)
    cells = [walkers.cells]
    for k in range(1, len(safe)):
        cells.append(walkers.step([[safe.at(k)]] * count))
    return ground.xy_of(np.array(cells))
