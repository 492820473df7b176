"""`MotionComparison` detects a disagreement between the motions of wheels and camera, and returns its explanations.

Both motions are cut into pieces of some centimetres or degrees. The wheels give a distance ahead and a rotation to the
left for each piece; the camera, by its mount, gives a translation and a rotation of three components each. All faults
are linear: a wheel that counts backwards, wrong sizes, a depth factor, a mirrored image, a rotated mount. So a Gram
matrix, the sum of products over all pieces, suffices. The residual of an explanation, as a share of both motions,
decides.

Motions alone leave ambiguities: mirrored images and swapped wheels both reverse rotations, and on a straight line short
depth and large wheels are equivalent. The height over the floor and a gyroscope resolve them.

`HYPOTHESES` on a faulty sensor are those of `SensorHealth` later in the drive, and `cause_of` describes a fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
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
# Largest residual, as a share of the squared motion, of motions that agree and of a good explanation. A scale that is
# 20 % off, or a direction that is 10° off, leaves more than the first; chosen.
_MAX_RESIDUAL_AGREE, _MAX_RESIDUAL_EXPLAINED = 0.03, 0.015
_SAME_SCALE = 0.15  # largest difference of the logarithm of the height over a floor; chosen
# Least rotation of a mount that differs, and least tilt of its vertical axis that moves the floor; chosen.
_LEAST_TURN_DEG, _LARGEST_TILT_DEG = 8.0, 10.0

_LEAST_WAY_M = 0.005  # a holonomic base's shorter translations have no direction: it turns on the spot
_LITTLE = 1e-3  # of the usual squares: the prior of a fit for a drive without turns
_UP = np.array([0.0, 0.0, 1.0])
_CAMERA_TRANSLATION, _CAMERA_ROTATION, _WHEELS = slice(2, 5), slice(5, 8), slice(2)

# The floor in one view: least sine of a ray's angle below the horizon that gives the height, bins and range of the
# height's logarithm (8 %, ten times as high or low), share of the largest bin and number of points that a floor has,
# and the slope halfway from a floor to a wall.
_STEEP, _BIN_LOG, _RANGE_LOG, _PEAK_SHARE, _FEWEST_POINTS, _STEEPEST_DEG = 0.2, 0.08, 2.3, 0.2, 40, 45.0


_LEAST_MIRRORED_RAD = 0.05  # turn of the wheels that distinguishes mirrored images from noise


class RobotSensor(Enum):
    """A sensor that may be faulty; `WHEELS` are both, as on ice."""

    LEFT = "left wheel"
    RIGHT = "right wheel"
    WHEELS = "both wheels"
    CAMERA = "camera"
    GYRO = "gyroscope"


LEFT, RIGHT, WHEELS, CAMERA, GYRO = RobotSensor
WHEEL_SENSORS = frozenset((LEFT, RIGHT, WHEELS))


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
        sensor: the sensor with the fault.
        cause: a clause that names the fault and its fix.
        expected: (6, 2) translation and rotation of the camera as a linear function of those of the wheels.
        is_scale: whether it is a scale factor. Clocks with an offset and slipping wheels may mimic one for a while.
        depth: the factor of depth, or None.
        tilts: whether it changes the vertical axis of the mount.
    """

    sensor: RobotSensor
    cause: str
    expected: FloatArray
    is_scale: bool = False
    depth: float | None = None
    tilts: bool = False


@dataclass(slots=True)
class MotionComparison:
    """The sums over all pieces, and the explanations that follow from them.

    Attributes:
        wheels: assumed wheels.
        T_base_camera: (4, 4) assumed mount.
        gram: (8, 8) sum of products of distance and rotation by wheels, translation (3) and rotation (3) by the camera,
            in the base's axes.
        of_gyro: (3, 3) the same of rotations by wheels, camera and gyroscope, for pieces with a gyroscope.
        pieces: number of pieces.
        rotation_tolerance_rad2: sum of squared rotations that slip and unequal radii may cause.
        distances_m, turns_rad: (2,) total distance and rotation by wheels and by the camera.
    """

    wheels: Wheels | HolonomicWheels
    T_base_camera: FloatArray
    gram: FloatArray = field(default_factory=lambda: np.zeros((8, 8)))
    of_gyro: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    pieces: int = 0
    rotation_tolerance_rad2: float = 0.0
    distances_m: FloatArray = field(default_factory=lambda: np.zeros(2))
    turns_rad: FloatArray = field(default_factory=lambda: np.zeros(2))

    @property
    def way_m(self) -> float:
        """Total distance, the larger of both."""
        return float(self.distances_m.max())

    @property
    def turn_rad(self) -> float:
        """Total rotation, the larger of both."""
        return float(self.turns_rad.max())

    def add(self, T_by_wheels: FloatArray, T_by_camera: FloatArray, gyro_rad: float | None) -> bool:
        """Add a piece, the base's motion (4, 4) by each; returns False if it is too short, and then adds nothing."""
        w, c = _way_and_turn(T_by_wheels), _way_and_turn(T_by_camera)
        distances_m, turns_rad = (np.array([_size(w[part]), _size(c[part])]) for part in (np.s_[:3], np.s_[3:]))
        if distances_m.max() < _PIECE_M and turns_rad.max() < _PIECE_RAD:
            return False
        if isinstance(self.wheels, HolonomicWheels):  # in axes along the direction of travel
            along = so3.exp([0.0, 0.0, -math.atan2(w[1], w[0]) if _size(w[:2]) > _LEAST_WAY_M else 0.0])
            w, c = (np.concatenate([along @ motion[:3], along @ motion[3:]]) for motion in (w, c))
        motion = np.array([w[0], w[5], *c])
        if gyro_rad is not None:
            turns = np.array([w[5], c[5], gyro_rad])
            self.of_gyro += np.outer(turns, turns)
        way_m = float(distances_m[0])
        if isinstance(self.wheels, HolonomicWheels):  # variance of the rotation by the wheels' slip
            slip_rad2 = self.wheels.turn_variance_per_m * way_m
        else:
            slip_rad2 = 2 * self.wheels.slip_m_per_sqrt_m**2 * way_m / self.wheels.track_width_m**2
        self.rotation_tolerance_rad2 += _SLIPS * slip_rad2 + (_DRIFT_RAD_PER_M * distances_m.max()) ** 2
        self.gram += np.outer(motion, motion)
        self.pieces += 1
        self.distances_m += distances_m
        self.turns_rad += turns_rad
        return True

    def unexplained(self, expected: FloatArray) -> tuple[float, float]:
        """The shares of translations and of rotations that `expected` (6, 2) does not explain."""
        G = self.gram
        cross = expected @ G[_WHEELS, 2:]
        residual = np.diag(G[2:, 2:] - cross - cross.T + expected @ G[_WHEELS, _WHEELS] @ expected.T)
        # Differences of usual size do not count; translations of turns on the spot are nothing else.
        usual = np.square([_USUAL_M, _USUAL_RAD]) / _MAX_RESIDUAL_AGREE
        least_m2, least_rad2 = self.pieces * usual
        way = max(np.trace(G[_CAMERA_TRANSLATION, _CAMERA_TRANSLATION]), G[0, 0], least_m2)
        turn = max(np.trace(G[_CAMERA_ROTATION, _CAMERA_ROTATION]), G[1, 1], least_rad2)
        of_rotation = max(float(residual[3:].sum() - self.rotation_tolerance_rad2), 0.0)
        return float(residual[:3].sum() / way), of_rotation / turn

    def agrees(self, most: float = _MAX_RESIDUAL_AGREE) -> bool:
        """Whether both motions agree up to a share `most` of their squares; default `_MAX_RESIDUAL_AGREE`."""
        return max(self.unexplained(_seen_of(np.eye(2)))) < most

    def explanations(self, floor_ratio: float | None, *, was_contradicted: bool = False) -> list[Explanation]:
        """The explanations of a disagreement, filtered by floor and gyroscope; none if both motions agree.

        Args:
            floor_ratio: the camera's height over the floor by its view divided by that by its mount; None if no floor
                is in view.
            was_contradicted: whether an explanation was found before; then a better agreement is needed to drop it.
        """
        if not self.pieces or self.agrees(_MAX_RESIDUAL_EXPLAINED if was_contradicted else _MAX_RESIDUAL_AGREE):
            return []
        mount_rotation = self._mount_rotation()
        is_near = min(mount_rotation[0, 0], mount_rotation[2, 2]) > math.cos(math.radians(_LEAST_TURN_DEG))
        camera_faults = self._of_camera() if is_near else [*self._of_camera(), self._of_mount(mount_rotation)]
        found = [*self._explained(self._of_wheels())[:1], *self._explained(camera_faults)]
        if not found and not is_near:  # the mount may also be at another place
            found = self._explained([self._of_mount(mount_rotation, self._camera_translations()[:, 1])])
        # The explanations that agree with the floor: its height is right, or wrong by the factor of depth.
        if floor_ratio is not None and abs(math.log(floor_ratio)) < _SAME_SCALE:
            found = [one for one in found if one.depth is None and not one.tilts]
        elif floor_ratio is not None:
            scales = [one for one in found if one.depth is not None]
            found = [one for one in scales if abs(math.log(floor_ratio / (one.depth or 1))) < _SAME_SCALE] or found
        return self._by_gyro(found)

    def _explained(self, candidates: list[Explanation]) -> list[Explanation]:
        return [one for one in candidates if max(self.unexplained(one.expected)) < _MAX_RESIDUAL_EXPLAINED]

    def _of_wheels(self) -> list[Explanation]:
        """Faults of wheels, the simplest first: signs, swapped wheels, sizes."""
        G = self.gram
        half_m = self.wheels.track_width_m / 2 if isinstance(self.wheels, Wheels) else 1.0
        left_backwards = np.array([[0.0, half_m], [1 / half_m, 0.0]])
        swapped = np.diag([1.0, -1.0])
        faults: tuple[tuple[FloatArray, str], ...] = (
            (left_backwards, "the left wheel counts backwards: turn its sign"),
            (-left_backwards, "the right wheel counts backwards: turn its sign"),
            (-np.eye(2), "both wheels count backwards: turn their signs"),
            (swapped, "left and right wheel are swapped: swap their columns"),
            (-swapped, "left and right wheel are swapped and count backwards: swap their columns and turn their signs"),
            (swapped @ left_backwards, "left and right wheel are swapped, and one counts backwards: see which"),
            (left_backwards @ swapped, "left and right wheel are swapped, and one counts backwards: see which"),
        )
        if isinstance(self.wheels, HolonomicWheels):
            faults = ((-np.eye(2), "all wheels count backwards: turn their signs"),)
        found = [Explanation(RobotSensor.WHEELS, cause, _seen_of(M)) for M, cause in faults]
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
                found.append(Explanation(RobotSensor.WHEELS, text, _seen_of(np.diag(M)), is_scale=True))
        return found

    def _of_camera(self) -> list[Explanation]:
        """Faults of the camera: depth factor and mirrored images."""
        way, R = _ratio(self.gram[0, 2], self.gram[0, 0]), self.T_base_camera[:3, :3]
        lever_arm_translation = np.cross(_UP, self._lever_arm)  # of the camera, per radian of the base
        found = []
        if 1 / _LARGEST_FACTOR < way < _LARGEST_FACTOR:
            expected = _seen_of(np.diag([way, 1.0]))
            expected[:3, 1] = (way - 1) * lever_arm_translation
            found.append(Explanation(RobotSensor.CAMERA, depth_cause(way), expected, True, way))
        for axis, how in enumerate(("left to right", "top to bottom")):
            mirror = R @ np.diag(np.where(np.arange(3) == axis, -1.0, 1.0)) @ R.T
            expected = np.zeros((6, 2))
            expected[:3, 0], expected[3:, 1] = mirror[:, 0], -mirror[:, 2]
            expected[:3, 1] = mirror @ lever_arm_translation + np.cross(mirror[:, 2], self._lever_arm)
            found.append(
                Explanation(
                    RobotSensor.CAMERA, f"its images are mirrored {how}: turn them back", expected, tilts=axis == 1
                )
            )
        return found

    @property
    def _lever_arm(self) -> FloatArray:
        """Position (3,) of the camera in the base frame."""
        return self.T_base_camera[:3, 3]

    def _camera_translations(self) -> FloatArray:
        """(3, 2) the camera's translation as a linear function of the wheels' distance and rotation, least squares."""
        G = self.gram
        usual = self.pieces * np.diag(np.square([_USUAL_M, _USUAL_RAD])) * _LITTLE
        return np.asarray(G[_CAMERA_TRANSLATION, _WHEELS] @ np.linalg.inv(G[_WHEELS, _WHEELS] + usual))

    def _mount_rotation(self) -> FloatArray:
        """The rotation (3, 3) that aligns the wheels' motions best with the camera's (Kabsch).

        The assumed mount is a prior with the usual differences as its standard deviation, because turns on the spot
        give no direction of travel.
        """
        G, M = self.gram, np.eye(3)
        M[:, 0] += self._camera_translations()[:, 0] * G[0, 0] / _USUAL_M**2
        M[:, 2] += G[_CAMERA_ROTATION, 1] / _USUAL_RAD**2
        return np.asarray(so3.nearest(M))

    def _of_mount(self, mount_rotation: FloatArray, lever_arm_translation: FloatArray | None = None) -> Explanation:
        """A rotated mount, at its assumed position or with a translation (3,) of the camera per radian of the base."""
        G, expected = self.gram, np.zeros((6, 2))
        expected[:3, 0], expected[3:, 1] = mount_rotation[:, 0], mount_rotation[:, 2]
        if lever_arm_translation is None:
            lever_arm_translation = np.cross(self._lever_arm - mount_rotation @ self._lever_arm, mount_rotation[:, 2])
        expected[:3, 1] = lever_arm_translation
        is_turning = G[1, 1] > self.pieces * _USUAL_RAD**2
        off_deg = (
            math.degrees(float(so3.angle(mount_rotation)))
            if is_turning
            else math.degrees(math.acos(min(max(mount_rotation[0, 0], -1.0), 1.0)))
        )
        cause = f"it looks about {off_deg:.0f}° from where T_base_camera says (wheelsight calibrate base finds it)"
        return Explanation(
            RobotSensor.CAMERA,
            cause,
            expected,
            tilts=is_turning and mount_rotation[2, 2] < math.cos(math.radians(_LARGEST_TILT_DEG)),
        )

    def _by_gyro(self, found: list[Explanation]) -> list[Explanation]:
        """The explanations that agree with the gyroscope, if that agrees clearly with one sensor."""
        wheels, camera, gyro = np.diag(self.of_gyro)
        if gyro < self.pieces * _USUAL_RAD**2 or len({one.sensor for one in found}) < 2:
            return found
        by_wheels = (wheels + gyro - 2 * self.of_gyro[0, 2]) / max(wheels, gyro)
        by_camera = (camera + gyro - 2 * self.of_gyro[1, 2]) / max(camera, gyro)
        if max(by_wheels, by_camera) < 2 * _MAX_RESIDUAL_AGREE or min(by_wheels, by_camera) > _MAX_RESIDUAL_AGREE:
            return found
        wrong = RobotSensor.CAMERA if by_wheels < by_camera else RobotSensor.WHEELS
        return [one for one in found if one.sensor is wrong]


def depth_cause(ratio: float) -> str:
    """The cause of a depth that is `ratio` times the true one, with its fix."""
    return f"depth is {ratio:.2g} times the true one: check depth_factor"


class Piece(NamedTuple):
    """Motions over a piece of a drive.

    Attributes:
        begin_s, end_s: stamps.
        camera: (6,) motion of the base by the camera, ξ.
        ways_m: (2,) of the left and the right wheel.
        turn_rad: of the gyroscope, or None.
        shows_all: whether all frames showed all directions; else only the camera's turn counts.
    """

    begin_s: float
    end_s: float
    camera: FloatArray
    ways_m: FloatArray
    turn_rad: float | None
    shows_all: bool = True


class Usual(NamedTuple):
    """Usual values in a drive.

    Attributes:
        ratios: (2,) of each wheel to the camera.
        bias_rad_s, bias_sigma_rad_s: of the gyroscope.
    """

    ratios: FloatArray
    bias_rad_s: float = 0.0
    bias_sigma_rad_s: float = 0.0


class Hypothesis(NamedTuple):
    """A way in which a sensor may be wrong.

    Attributes:
        sensor: the sensor.
        broken: places of the sensor's errors among x, y and yaw of the camera, left and right wheel, gyroscope, whose
            variance grows.
        scale: of that growth, as a share of way or turn.
        flips: what the sensor measures in place of the truth: (left wheel, right wheel, yaw and y of the camera,
            gyroscope) times these.
    """

    sensor: RobotSensor
    broken: tuple[int, ...] = ()
    scale: float = 0.0
    flips: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)


_ANY, _SOME = 0.5, 0.1
HYPOTHESES = (
    Hypothesis(LEFT, (3,), _ANY),
    Hypothesis(LEFT, (3,), _SOME),
    Hypothesis(LEFT, flips=(0.0, 1.0, 1.0, 1.0)),
    Hypothesis(LEFT, flips=(-1.0, 1.0, 1.0, 1.0)),
    Hypothesis(RIGHT, (4,), _ANY),
    Hypothesis(RIGHT, (4,), _SOME),
    Hypothesis(RIGHT, flips=(1.0, 0.0, 1.0, 1.0)),
    Hypothesis(RIGHT, flips=(1.0, -1.0, 1.0, 1.0)),
    Hypothesis(WHEELS, (3, 4), _ANY),
    Hypothesis(WHEELS, flips=(0.0, 0.0, 1.0, 1.0)),
    Hypothesis(WHEELS, flips=(-1.0, -1.0, 1.0, 1.0)),
    Hypothesis(CAMERA, (0, 1, 2), _ANY),
    Hypothesis(CAMERA, (0,), _SOME),
    Hypothesis(CAMERA, flips=(1.0, 1.0, -1.0, 1.0)),
    Hypothesis(GYRO, (6,), _ANY),
    Hypothesis(GYRO, flips=(1.0, 1.0, 1.0, 0.0)),
    Hypothesis(GYRO, flips=(1.0, 1.0, 1.0, -1.0)),
)
PLACES = {LEFT: [3], RIGHT: [4], WHEELS: [3, 4], CAMERA: [0, 1, 2], GYRO: [6]}
ANY_CAMERA = HYPOTHESES.index(Hypothesis(CAMERA, (0, 1, 2), _ANY))
MIRRORED = HYPOTHESES.index(Hypothesis(CAMERA, flips=(1.0, 1.0, -1.0, 1.0)))
SCALES = np.array([[one.scale if place in one.broken else 0.0 for place in range(7)] for one in HYPOTHESES])
FLIPS = np.array([one.flips for one in HYPOTHESES])
OF_SENSOR = {sensor: [n for n, one in enumerate(HYPOTHESES) if one.sensor is sensor] for sensor in RobotSensor}


def ways_by_camera(camera: FloatArray, half_m: float) -> FloatArray:
    """Return the ways (N, 2) of both wheels, m, by motions (N, 6) of the base by the camera; `half_m` of the track."""
    return np.asarray(camera[:, :1] + half_m * camera[:, 5:] * (-1, 1))


def wheel_ways(pieces: Sequence[Piece], wheel: RobotSensor, usual: Usual, half_m: float) -> tuple[FloatArray, ...]:
    """Return the ways (N,) of the left or right wheel over pieces, m: measured, and by the camera."""
    side = 0 if wheel is LEFT else 1
    camera = np.array([one.camera for one in pieces]).reshape(-1, 6)
    return np.array([one.ways_m[side] for one in pieces]), usual.ratios[side] * ways_by_camera(camera, half_m)[:, side]


def begin_of_scale(pieces: Sequence[Piece], zero_s: float, measured_m: FloatArray, true_m: FloatArray) -> float:
    """Return the stamp at which the wrong scale of a wheel most likely began, `zero_s` or earlier.

    A slow piece agrees with both scales, and a sum of `Sums` stays zero. The scale is that of pieces since `zero_s`;
    before, the begin is where squared residuals by it are less than those by the usual scale by most.
    """
    after = sum(one.end_s <= zero_s for one in pieces)
    factor, _ = factor_of(measured_m[after:], true_m[after:])
    gains = np.cumsum(((measured_m - true_m) ** 2 - (measured_m - factor * true_m) ** 2)[:after][::-1])
    return pieces[after - 1 - int(gains.argmax())].begin_s if gains.max(initial=0.0) > 0.0 else zero_s


def factor_of(measured: FloatArray, true: FloatArray) -> tuple[float, float]:
    """Return the factor of a measurement (N,), by least squares, and its standard deviation by the residuals."""
    squares = max(float(true @ true), 1e-12)
    factor = float(measured @ true) / squares
    left = measured - factor * true
    return factor, math.sqrt(float(left @ left) / max(len(true) - 1, 1) / squares)


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
    wheel_turns = (ways_m[:, 1] - ways_m[:, 0]) / (2 * half_m)
    if sensor in (LEFT, RIGHT):
        i = 0 if sensor is LEFT else 1
        factor, _ = factor_of(ways_m[:, i], ratios[i] * ways_by_camera(camera, half_m)[:, i])
        if abs(factor) < 0.1:
            return "it does not count while the robot moves; check its encoder and cable"
        if factor < -0.5:
            return "it counts backwards; check the channels of its encoder"
        return f"it counts {factor:.2f} times its way; check its tyre and encoder"
    if sensor is WHEELS:
        factor, _ = factor_of(ways_m.mean(axis=1), camera[:, 0])
        return f"both count {factor:.2f} times their way; they slip, or the robot was lifted"
    if sensor is GYRO:
        factor, _ = factor_of(turns_rad[np.isfinite(turns_rad)], camera[np.isfinite(turns_rad), 5])
        return f"it measures {factor:.2f} times the turns of camera and wheels; check its mounting and scale"
    if np.abs(camera[:, 1]).sum() > 0.3 * np.abs(ways_m).max(axis=1).sum():
        return "it moves sideways, which the robot cannot; something that moves may fill its view"
    if np.abs(wheel_turns).sum() > _LEAST_MIRRORED_RAD and factor_of(camera[:, 5], wheel_turns)[0] < -0.5:
        return "it turns the other way than the wheels; check whether its images are mirrored"
    factor, _ = factor_of(camera[:, 0], ways_m.mean(axis=1))
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
