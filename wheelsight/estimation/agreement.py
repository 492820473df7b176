"""`Agreement` detects a disagreement between the motions of wheels and camera, and returns its possible explanations.

Both motions are cut into pieces of some centimetres or degrees. The wheels give a distance ahead and a rotation to the
left for each piece; the camera, by its mount, gives a translation and a rotation of three components each. All faults
are linear: a wheel that counts backwards, wrong sizes, a depth factor, a mirrored image, a rotated mount. So sums of
products over all pieces suffice, and the share of both motions that an explanation leaves over decides.

Motions alone leave ambiguities: mirrored images and swapped wheels both reverse rotations, and on a straight line short
depth and large wheels are equivalent. The height over the floor and a gyroscope resolve them.

`cause_of` describes the fault of a sensor that `SensorHealth` found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.geometry import FloatArray, so3

# A piece ends after this distance or rotation by either sensor: a camera errs by a millimetre or two, and a robot at
# 0.5 m/s is reported after its first three frames. In each piece both may differ by the usual amount, because clocks
# differ by milliseconds. Chosen; simulator.
_PIECE_M, _PIECE_RAD, _USUAL_M, _USUAL_RAD = 0.06, 0.06, 0.01, 0.01
# Tolerance of rotations, as a multiple of the calibration's slip, and by radii that differ by 2 %, rad/m; chosen.
_SLIPS, _DRIFT_RAD_PER_M = 2.0, 0.04
_LARGEST_FACTOR = 100.0  # of sizes: a missing gear; beyond, only one sensor reports motion
# Share of the squared motion beyond which both disagree, a scale of 20 % or a direction of 10°, and that a good
# explanation leaves; chosen.
_DISAGREES, _EXPLAINED = 0.03, 0.015
_SAME_SCALE = 0.15  # largest difference of the logarithm of the height over a floor; chosen
# Least rotation of a mount that differs, and least tilt of its vertical axis that moves the floor; chosen.
_LEAST_TURN_DEG, _LARGEST_TILT_DEG = 8.0, 10.0

_LEAST_WAY_M = 0.005  # a holonomic base's shorter translations have no direction: it turns on the spot
_LITTLE = 1e-3  # of the usual squares: the prior of a fit for a drive without turns
_UP = np.array([0.0, 0.0, 1.0])
_WAYS, _TURNS, _WHEELS = slice(2, 5), slice(5, 8), slice(2)

# The floor in one view: least sine of a ray's angle below the horizon that gives the height, bins and range of the
# height's logarithm (8 %, ten times as high or low), share of the largest bin and number of points that a floor has,
# and the slope halfway from a floor to a wall.
_STEEP, _BIN_LOG, _RANGE_LOG, _PEAK_SHARE, _FEWEST_POINTS, _STEEPEST_DEG = 0.2, 0.08, 2.3, 0.2, 40, 45.0


_LEAST_MIRRORED_RAD = 0.05  # turn of the wheels that distinguishes mirrored images from noise


class Culprit(Enum):
    """The sensor whose motions are wrong."""

    WHEELS = "wheels"
    CAMERA = "camera"


class RobotSensor(Enum):
    """A sensor that may be faulty; `WHEELS` are both, as on ice."""

    LEFT = "left wheel"
    RIGHT = "right wheel"
    WHEELS = "both wheels"
    CAMERA = "camera"
    GYRO = "gyroscope"


class Exclusion(NamedTuple):
    """A sensor that is left out from one stamp to another, by a fault (`is_sure`) or by a suspicion."""

    sensor: RobotSensor
    begin_s: float
    end_s: float = math.inf
    is_sure: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A fault that explains all pieces.

    Attributes:
        culprit: the sensor with the fault.
        cause: a clause that names the fault and its fix.
        expected: (6, 2) translation and rotation of the camera as a linear function of those of the wheels.
        is_scale: whether it is a scale factor. Clocks with an offset and slipping wheels may mimic one for a while.
        depth: the factor of depth, or None.
        tilts: whether it changes the vertical axis of the mount.
    """

    culprit: Culprit
    cause: str
    expected: FloatArray
    is_scale: bool = False
    depth: float | None = None
    tilts: bool = False


@dataclass(slots=True)
class Agreement:
    """The sums over all pieces, and the explanations that follow from them.

    Attributes:
        wheels: assumed wheels.
        T_base_camera: (4, 4) assumed mount.
        products: (8, 8) of distance and rotation by wheels, translation (3) and rotation (3) by the camera, in the
            base's axes.
        of_gyro: (3, 3) of rotations by wheels, camera and gyroscope, for pieces with a gyroscope.
        pieces: number of pieces.
        drift: sum of squared rotations, the tolerance of rotations by slip and drift.
        ways_m, turns_rad: (2,) total distance and rotation by wheels and by the camera.
    """

    wheels: Wheels | HolonomicWheels
    T_base_camera: FloatArray
    products: FloatArray = field(default_factory=lambda: np.zeros((8, 8)))
    of_gyro: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    pieces: int = 0
    drift: float = 0.0
    ways_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    turns_rad: FloatArray = field(default_factory=lambda: np.zeros(2))

    @property
    def way_m(self) -> float:
        """Total distance, the larger of both."""
        return float(self.ways_m.max())

    @property
    def turn_rad(self) -> float:
        """Total rotation, the larger of both."""
        return float(self.turns_rad.max())

    def add(self, T_by_wheels: FloatArray, T_by_camera: FloatArray, gyro_rad: float | None) -> bool:
        """Add a piece, the base's motion (4, 4) by each; returns False if it is too short, and then adds nothing."""
        w, c = _way_and_turn(T_by_wheels), _way_and_turn(T_by_camera)
        ways_m, turns_rad = (np.array([_size(w[part]), _size(c[part])]) for part in (np.s_[:3], np.s_[3:]))
        if ways_m.max() < _PIECE_M and turns_rad.max() < _PIECE_RAD:
            return False
        if isinstance(self.wheels, HolonomicWheels):  # in axes along the direction of travel
            along = so3.exp([0.0, 0.0, -math.atan2(w[1], w[0]) if _size(w[:2]) > _LEAST_WAY_M else 0.0])
            w, c = (np.concatenate([along @ motion[:3], along @ motion[3:]]) for motion in (w, c))
        motion = np.array([w[0], w[5], *c])
        if gyro_rad is not None:
            turns = np.array([w[5], c[5], gyro_rad])
            self.of_gyro += np.outer(turns, turns)
        way_m = float(ways_m[0])
        if isinstance(self.wheels, HolonomicWheels):  # variance of the rotation by the wheels' slip
            slip_rad2 = self.wheels.turn_variance_per_m * way_m
        else:
            slip_rad2 = 2 * self.wheels.slip_m_per_sqrt_m**2 * way_m / self.wheels.track_width_m**2
        self.drift += _SLIPS * slip_rad2 + (_DRIFT_RAD_PER_M * ways_m.max()) ** 2
        self.products += np.outer(motion, motion)
        self.pieces += 1
        self.ways_m += ways_m
        self.turns_rad += turns_rad
        return True

    def unexplained(self, expected: FloatArray) -> tuple[float, float]:
        """The shares of translations and of rotations that `expected` (6, 2) does not explain."""
        G = self.products
        cross = expected @ G[_WHEELS, 2:]
        left = np.diag(G[2:, 2:] - cross - cross.T + expected @ G[_WHEELS, _WHEELS] @ expected.T)
        # Differences of usual size do not count; translations of turns on the spot are nothing else.
        usual = np.square([_USUAL_M, _USUAL_RAD]) / _DISAGREES
        least_m2, least_rad2 = self.pieces * usual
        way = max(np.trace(G[_WAYS, _WAYS]), G[0, 0], least_m2)
        turn = max(np.trace(G[_TURNS, _TURNS]), G[1, 1], least_rad2)
        return float(left[:3].sum() / way), max(float(left[3:].sum() - self.drift), 0.0) / turn

    def agrees(self, most: float = _DISAGREES) -> bool:
        """Whether both motions agree up to a share `most` of their squares; default `_DISAGREES`."""
        return max(self.unexplained(_seen_of(np.eye(2)))) < most

    def explanations(self, floor_ratio: float | None, *, was_contradicted: bool = False) -> list[Explanation]:
        """The explanations of a disagreement, filtered by floor and gyroscope; none if both motions agree.

        Args:
            floor_ratio: the camera's height over the floor by its view divided by that by its mount; None if no floor
                is in view.
            was_contradicted: whether an explanation was found before; then a better agreement is needed to drop it.
        """
        if not self.pieces or self.agrees(_EXPLAINED if was_contradicted else _DISAGREES):
            return []
        turned = self._turned()
        is_near = min(turned[0, 0], turned[2, 2]) > math.cos(math.radians(_LEAST_TURN_DEG))
        looks_elsewhere = [] if is_near else [self._of_mount(turned)]
        fit = [*self._explained(self._of_wheels())[:1], *self._explained([*self._of_camera(), *looks_elsewhere])]
        found = fit or self._explained([self._of_mount(turned, self._swings()[:, 1]) for _ in looks_elsewhere])
        # The explanations that agree with the floor: its height is right, or wrong by the factor of depth.
        if floor_ratio is not None and abs(math.log(floor_ratio)) < _SAME_SCALE:
            found = [one for one in found if one.depth is None and not one.tilts]
        elif floor_ratio is not None:
            scales = [one for one in found if one.depth is not None]
            found = [one for one in scales if abs(math.log(floor_ratio / (one.depth or 1))) < _SAME_SCALE] or found
        return self._by_gyro(found)

    def _explained(self, candidates: list[Explanation]) -> list[Explanation]:
        return [one for one in candidates if max(self.unexplained(one.expected)) < _EXPLAINED]

    def _of_wheels(self) -> list[Explanation]:
        """Faults of wheels, the simplest first: signs, swapped wheels, sizes."""
        G = self.products
        half_m = self.wheels.track_width_m / 2 if isinstance(self.wheels, Wheels) else 1.0
        left = np.array([[0.0, half_m], [1 / half_m, 0.0]])
        swapped = np.diag([1.0, -1.0])
        ways: tuple[tuple[FloatArray, str], ...] = (
            (left, "the left wheel counts backwards: turn its sign"),
            (-left, "the right wheel counts backwards: turn its sign"),
            (-np.eye(2), "both wheels count backwards: turn their signs"),
            (swapped, "left and right wheel are swapped: swap their columns"),
            (-swapped, "left and right wheel are swapped and count backwards: swap their columns and turn their signs"),
            (swapped @ left, "left and right wheel are swapped, and one counts backwards: see which"),
            (left @ swapped, "left and right wheel are swapped, and one counts backwards: see which"),
        )
        if isinstance(self.wheels, HolonomicWheels):
            ways = ((-np.eye(2), "all wheels count backwards: turn their signs"),)
        found = [Explanation(Culprit.WHEELS, cause, _seen_of(M)) for M, cause in ways]
        way, turn = _ratio(G[0, 2], G[0, 0]), _ratio(G[1, 7], G[1, 1])
        weights = np.array([G[0, 0] / _USUAL_M**2, G[1, 1] / _USUAL_RAD**2])
        both = float(weights @ [way, turn] / max(weights.sum(), 1e-12))
        sizes = (
            ((both, both), both, "their ways and turns are {} times the true ones: check ticks_per_turn and radii"),
            ((1.0, turn), turn, "their turns are {} times the true ones: check track_width_m"),
            ((way, 1.0), way, "their ways, not their turns, are {} times the true ones: check radii and track_width_m"),
        )
        for M, ratio, cause in sizes:
            if 1 / _LARGEST_FACTOR < ratio < _LARGEST_FACTOR:
                text = cause.format(f"{1 / ratio:.2g}")
                found.append(Explanation(Culprit.WHEELS, text, _seen_of(np.diag(M)), is_scale=True))
        return found

    def _of_camera(self) -> list[Explanation]:
        """Faults of the camera: depth factor and mirrored images."""
        way, R = _ratio(self.products[0, 2], self.products[0, 0]), self.T_base_camera[:3, :3]
        swing = np.cross(_UP, self._place)  # of the camera, in a rotation of the base
        found = []
        if 1 / _LARGEST_FACTOR < way < _LARGEST_FACTOR:
            expected = _seen_of(np.diag([way, 1.0]))
            expected[:3, 1] = (way - 1) * swing
            found.append(Explanation(Culprit.CAMERA, depth_cause(way), expected, True, way))
        for axis, how in enumerate(("left to right", "top to bottom")):
            over = R @ np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)) @ R.T
            expected = np.zeros((6, 2))
            expected[:3, 0], expected[3:, 1] = over[:, 0], -over[:, 2]
            expected[:3, 1] = over @ swing + np.cross(over[:, 2], self._place)
            found.append(
                Explanation(Culprit.CAMERA, f"its images are mirrored {how}: turn them back", expected, tilts=axis == 1)
            )
        return found

    @property
    def _place(self) -> FloatArray:
        """Position (3,) of the camera in the base frame."""
        return self.T_base_camera[:3, 3]

    def _swings(self) -> FloatArray:
        """(3, 2) the camera's translation as a linear function of the wheels' distance and rotation, least squares."""
        G = self.products
        usual = self.pieces * np.diag(np.square([_USUAL_M, _USUAL_RAD])) * _LITTLE
        return np.asarray(G[_WAYS, _WHEELS] @ np.linalg.inv(G[_WHEELS, _WHEELS] + usual))

    def _turned(self) -> FloatArray:
        """The rotation (3, 3) that aligns the wheels' motions best with the camera's (Kabsch).

        The assumed mount is a prior with the usual differences as its standard deviation, because turns on the spot
        give no direction of travel.
        """
        G, M = self.products, np.eye(3)
        M[:, 0] += self._swings()[:, 0] * G[0, 0] / _USUAL_M**2
        M[:, 2] += G[_TURNS, 1] / _USUAL_RAD**2
        return np.asarray(so3.nearest(M))

    def _of_mount(self, turned: FloatArray, swing: FloatArray | None = None) -> Explanation:
        """A mount rotated by `turned` at its assumed position, or with the translation `swing` (3,) in a rotation."""
        G, expected = self.products, np.zeros((6, 2))
        expected[:3, 0], expected[3:, 1] = turned[:, 0], turned[:, 2]
        expected[:3, 1] = np.cross(self._place - turned @ self._place, turned[:, 2]) if swing is None else swing
        is_turning = G[1, 1] > self.pieces * _USUAL_RAD**2
        off_deg = (
            math.degrees(float(so3.angle(turned)))
            if is_turning
            else math.degrees(math.acos(min(max(turned[0, 0], -1.0), 1.0)))
        )
        cause = f"it looks about {off_deg:.0f}° from where T_base_camera says (wheelsight calibrate base finds it)"
        return Explanation(
            Culprit.CAMERA,
            cause,
            expected,
            tilts=is_turning and turned[2, 2] < math.cos(math.radians(_LARGEST_TILT_DEG)),
        )

    def _by_gyro(self, found: list[Explanation]) -> list[Explanation]:
        """The explanations that agree with the gyroscope, if that agrees clearly with one sensor."""
        wheels, camera, gyro = np.diag(self.of_gyro)
        if gyro < self.pieces * _USUAL_RAD**2 or len({one.culprit for one in found}) < 2:
            return found
        by_wheels = (wheels + gyro - 2 * self.of_gyro[0, 2]) / max(wheels, gyro)
        by_camera = (camera + gyro - 2 * self.of_gyro[1, 2]) / max(camera, gyro)
        if max(by_wheels, by_camera) < 2 * _DISAGREES or min(by_wheels, by_camera) > _DISAGREES:
            return found
        wrong = Culprit.CAMERA if by_wheels < by_camera else Culprit.WHEELS
        return [one for one in found if one.culprit is wrong]


def depth_cause(ratio: float) -> str:
    """The cause of a depth that is `ratio` times the true one, with its fix."""
    return f"depth is {ratio:.2g} times the true one: check depth_factor"


def cause_of(
    sensor: RobotSensor,
    camera: FloatArray,
    ways_m: FloatArray,
    turns_rad: FloatArray,
    half_m: float,
    ratios: FloatArray,
) -> str:
    """Return what is wrong with a sensor over some pieces of a drive, and what to check.

    Args:
        sensor: the faulty one.
        camera: (N, 6) motions of the base by the camera, ξ.
        ways_m: (N, 2) of the left and the right wheel.
        turns_rad: (N,) of the gyroscope; NaN without one.
        half_m: half of the track.
        ratios: (2,) usual ratio of each wheel to the camera.
    """

    def times(measured: FloatArray, true: FloatArray) -> float:
        """Return the factor of a measurement, by least squares."""
        return float(measured @ true / max(float(true @ true), 1e-12))

    wheel_turns = (ways_m[:, 1] - ways_m[:, 0]) / (2 * half_m)
    if sensor in (RobotSensor.LEFT, RobotSensor.RIGHT):
        i = 0 if sensor is RobotSensor.LEFT else 1
        by_camera = camera[:, 0] + half_m * camera[:, 5] * (-1, 1)[i]
        factor = times(ways_m[:, i], ratios[i] * by_camera)
        if abs(factor) < 0.1:
            return "it does not count while the robot moves; check its encoder and cable"
        if factor < -0.5:
            return "it counts backwards; check the channels of its encoder"
        return f"it counts {factor:.2f} times its way; check its tyre and encoder"
    if sensor is RobotSensor.WHEELS:
        factor = times(ways_m.mean(axis=1), camera[:, 0])
        return f"both count {factor:.2f} times their way; they slip, or the robot was lifted"
    if sensor is RobotSensor.GYRO:
        factor = times(turns_rad[np.isfinite(turns_rad)], camera[np.isfinite(turns_rad), 5])
        return f"it measures {factor:.2f} times the turns of camera and wheels; check its mounting and scale"
    if np.abs(camera[:, 1]).sum() > 0.3 * np.abs(ways_m).max(axis=1).sum():
        return "it moves sideways, which the robot cannot; something that moves may fill its view"
    if np.abs(wheel_turns).sum() > _LEAST_MIRRORED_RAD and times(camera[:, 5], wheel_turns) < -0.5:
        return "it turns the other way than the wheels; check whether its images are mirrored"
    factor = times(camera[:, 0], ways_m.mean(axis=1))
    return f"it moves {factor:.2f} times the way of the wheels; check its mount and depth"


def height_below(rays: FloatArray, depth_m: FloatArray, up_camera: FloatArray, expected_m: float) -> float | None:
    """The approximate height of a camera over the floor by one view; None if no floor is in view.

    Steep rays give the height even if `up_camera` is some degrees off. The plane must be level, which excludes a wall
    that fills the view.

    Args:
        rays: (N, 3) with z = 1.
        depth_m: (N,), 0 where nothing was measured; its unit may be wrong.
        up_camera: (3,) by the mount.
        expected_m: the height by the mount; the search covers a tenth of it to ten times it.
    """
    down = -(rays @ up_camera)
    is_steep = (down > _STEEP * np.linalg.norm(rays, axis=-1)) & (depth_m > 0)
    logs = np.log(down[is_steep] * depth_m[is_steep] / expected_m)
    counts, edges = np.histogram(logs, np.arange(-_RANGE_LOG, _RANGE_LOG, _BIN_LOG))
    pairs = counts[:-1] + counts[1:]
    many = np.flatnonzero(pairs >= max(_PEAK_SHARE * pairs.max(initial=0), _FEWEST_POINTS))
    if not len(many):
        return None
    lowest = (logs >= edges[many[-1]]) & (logs < edges[many[-1] + 2])
    q = np.linalg.lstsq(rays[is_steep][lowest], 1 / depth_m[is_steep][lowest])[0]
    if not bool(-(q @ up_camera) > math.cos(math.radians(_STEEPEST_DEG)) * np.linalg.norm(q)):
        return None
    return float(expected_m * np.exp(np.median(logs[lowest])))


def _way_and_turn(T: FloatArray) -> FloatArray:
    """(6,) translation, in the axes halfway through the rotation, and rotation of a motion (4, 4)."""
    turn = so3.log(T[:3, :3])
    return np.concatenate([so3.exp(-turn / 2) @ T[:3, 3], turn])


def _seen_of(M: FloatArray) -> FloatArray:
    """(6, 2) motion of a camera if the true distance and rotation are M (2, 2) times those by the wheels."""
    expected = np.zeros((6, 2))
    expected[0], expected[5] = M
    return expected


def _ratio(product: float, square: float) -> float:
    """A factor by least squares; 1 if it is unobservable."""
    return float(product / square) if abs(product) > 1e-6 else 1.0


def _size(v: FloatArray) -> float:
    return float(np.linalg.norm(v))
