"""How a body moves on its tyres and springs, and the camera with it; what wheels feel of the floor."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.linalg.blas import dtbsv
from scipy.ndimage import gaussian_filter1d

from wheelsight.core.geometry import BoolArray, ByteArray, Float32Array, FloatArray, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim.robot import RobotModel
from wheelsight_sim.world import World

CASTOR_X_M, CASTOR_Y_M = 0.45, 0.17
_SMOOTH_S = 0.02


@dataclass(frozen=True, slots=True)
class BodySettings:
    """Springs, and what trembles.

    A wheelchair of 130 kg, its mass 0.42 m high, on four tyres of 80 kN/m that stand 0.45 m and 0.52 m apart: 16 kNm
    a radian of pitch, 22 of roll; about its tyres it has 37 kg m².

    Attributes:
        pitch_rad_s2_m: pitch a m/s² of acceleration: 130 kg · 0.42 m / 16.2 kNm.
        roll_rad_s2_m: roll a m/s² across: the same over 21.6 kNm.
        own_rad_s: natural frequency of pitch, √(16.2 kNm / 37 kg m²): 3.3 Hz.
        damping: of tyres and a seated rider, as a share of the critical one. Chosen.
        bands_hz: edges of the bands in which vibration was measured.
        roll_rad_s, pitch_rad_s, yaw_rad_s: root mean square of the rates in these bands, driving at `speed_m_s`:
            gyroscopes of `skid_steer_run20` (100 Hz), in 36 pieces of 2 s over 0.9 m/s. Below 3 Hz a body moves by
            acceleration and bumps instead.
        speed_m_s: at which that is so; vibration grows with the root of the speed: 12 pieces of 0.3 to 0.9 m/s have
            0.8 of it.
    """

    pitch_rad_s2_m: float = 0.0034
    roll_rad_s2_m: float = 0.0025
    own_rad_s: float = 21.0
    damping: float = 0.3
    bands_hz: tuple[float, ...] = (3.0, 6.0, 10.0, 15.0, 25.0, 35.0, 50.0)
    roll_rad_s: tuple[float, ...] = (0.0156, 0.0136, 0.0073, 0.0048, 0.0011, 0.0005)
    pitch_rad_s: tuple[float, ...] = (0.0150, 0.0127, 0.0091, 0.0040, 0.0007, 0.0005)
    yaw_rad_s: tuple[float, ...] = (0.0168, 0.0077, 0.0050, 0.0027, 0.0007, 0.0005)
    speed_m_s: float = 1.1


class BodyMotion:
    """The body's motion against the base along one drive.

    `truth` is T_world_base at a constant rate; the wheels meet the floor.
    """

    def __init__(
        self,
        truth: Trajectory,
        robot: RobotModel,
        floor: FloorSurface,
        settings: BodySettings,
        rng: np.random.Generator,
    ) -> None:
        self._stamps_s = truth.stamps_s
        period_s = float(np.median(np.diff(self._stamps_s)))
        T = truth.T_frame_body
        velocity, yaw_rad = np.gradient(T[:, :2, 3], period_s, axis=0), np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
        forward = np.einsum("ni,ni->n", velocity, np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1))
        speed_m_s = gaussian_filter1d(forward, _SMOOTH_S / period_s)
        turn_rad_s = gaussian_filter1d(np.gradient(yaw_rad, period_s), _SMOOTH_S / period_s)
        pitch, roll, self._up_m = jolts(truth.T_frame_body, robot, floor)
        pitch -= settings.pitch_rad_s2_m * np.gradient(speed_m_s, period_s)
        roll += settings.roll_rad_s2_m * speed_m_s * turn_rad_s
        rim_m_s = np.abs(speed_m_s) + np.abs(turn_rad_s) * robot.track_width_m / 2
        strength = np.sqrt(rim_m_s / settings.speed_m_s)
        shakes = [
            strength * trembling(len(rim_m_s), period_s, settings.bands_hz, rates, rng)
            for rates in (settings.roll_rad_s, settings.pitch_rad_s, settings.yaw_rad_s)
        ]
        self._up_m = sprung(self._up_m, settings, period_s)
        self._angles_rad = np.stack(shakes)
        self._angles_rad[0] += sprung(roll, settings, period_s)
        self._angles_rad[1] += sprung(pitch, settings, period_s)

    def T_base_body(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) where the body is, at times (N,), from where it is on a level floor at rest."""
        stamps_s = np.atleast_1d(np.asarray(stamps_s, float))
        xi = np.zeros((len(stamps_s), 6))
        xi[:, 2] = np.interp(stamps_s, self._stamps_s, self._up_m)
        for axis, angle_rad in enumerate(self._angles_rad):
            xi[:, 3 + axis] = np.interp(stamps_s, self._stamps_s, angle_rad)
        return np.asarray(se3.exp(xi))


def jolts(
    T_world_base: FloatArray, robot: RobotModel, floor: FloorSurface
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pitch, roll (N,) in radians and rise (N,) in metres of a stiff body whose wheels stand on the floor as it is."""
    half_m = robot.track_width_m / 2
    contacts = np.array([[0, half_m, 0], [0, -half_m, 0], [CASTOR_X_M, CASTOR_Y_M, 0], [CASTOR_X_M, -CASTOR_Y_M, 0]])
    places = se3.apply(T_world_base, contacts)[..., :2]
    left, right, front_left, front_right = np.moveaxis(floor.height_m(places), -1, 0)
    back_m, front_m = 0.5 * (left + right), 0.5 * (front_left + front_right)
    return (back_m - front_m) / CASTOR_X_M, (left - right) / (2 * half_m), back_m


def sprung(goal: FloatArray, settings: BodySettings, period_s: float) -> FloatArray:
    """What a mass on a spring does whose rest position is `goal` (N,)."""
    (b0, b1, b2), (_, a1, a2) = spring(settings, period_s)
    x = goal - goal[0]
    driven = b0 * x
    driven[1:] += b1 * x[:-1]
    driven[2:] += b2 * x[:-2]
    # y[n] + a1 y[n-1] + a2 y[n-2] = driven[n], three bands of a triangle: scipy.signal, whose lfilter does the same,
    # takes half a second to load.
    bands = np.empty((3, len(x)), order="F")
    bands[:] = np.array([[1.0], [a1], [a2]])
    return np.asarray(dtbsv(2, bands, driven, lower=1, diag=1) + goal[0], float)


def spring(settings: BodySettings, period_s: float) -> tuple[FloatArray, FloatArray]:
    """The filter b, a (3,) from rest position to position of a damped mass, sampled by the bilinear transform."""
    own, k = settings.own_rad_s, 2 / period_s
    damped = 2 * settings.damping * own * k
    first = k**2 + damped + own**2
    b = np.array([damped + own**2, 2 * own**2, own**2 - damped])
    a = np.array([first, 2 * own**2 - 2 * k**2, k**2 - damped + own**2])
    return b / first, a / first


def trembling(
    count: int, period_s: float, bands_hz: tuple[float, ...], rates_rad_s: tuple[float, ...], rng: np.random.Generator
) -> FloatArray:
    """Angles (N,) in radians whose rates have the given root mean squares in the bands."""
    whole = next_fast_len(max(count, 2))
    spectrum = rfft(rng.standard_normal(whole))
    f_hz = rfftfreq(whole, period_s)
    gain = np.zeros_like(f_hz)
    for low_hz, high_hz, rate_rad_s in zip(bands_hz[:-1], bands_hz[1:], rates_rad_s, strict=True):
        inside = (f_hz >= low_hz) & (f_hz < high_hz)
        # White noise has 2 · period of variance a hertz.
        density = rate_rad_s**2 / (high_hz - low_hz) / (2 * period_s)
        gain[inside] = np.sqrt(density) / (2 * np.pi * f_hz[inside])
    return np.asarray(irfft(spectrum * gain, whole)[:count])


_TREMBLING_REPEATS_S = 600.0  # its spectrum has no edges, so that the end goes on as the beginning
_KEPT_S = 1.0


class LiveBodyMotion:
    """`BodyMotion`, known up to the last `step`.

    Speeds are smoothed over the past alone, so that pitch comes 20 ms later than in `BodyMotion`.
    """

    def __init__(
        self, period_s: float, robot: RobotModel, floor: FloorSurface, settings: BodySettings, rng: np.random.Generator
    ) -> None:
        self._period_s, self._robot, self._floor, self._settings = period_s, robot, floor, settings
        rates = settings.roll_rad_s, settings.pitch_rad_s, settings.yaw_rad_s
        count = round(_TREMBLING_REPEATS_S / period_s)
        self._trembling = np.stack([trembling(count, period_s, settings.bands_hz, rate, rng) for rate in rates])
        self._springs = [_Spring(settings, period_s) for _ in range(3)]
        self._before: FloatArray | None = None
        self._smoothed = self._speeds = np.zeros(2)
        self._angles: deque[FloatArray] = deque(maxlen=round(_KEPT_S / period_s))
        self._steps = 0

    def step(self, T_world_base: FloatArray) -> None:
        """The base is here one period after the last step."""
        settings, before_m_s = self._settings, self._speeds[0]
        if self._before is not None:
            # Forward speed in m/s and yaw rate in rad/s, smoothed twice over half of the time each.
            moved = se3.compose(se3.invert(self._before), T_world_base)
            now = np.array([moved[0, 3], math.atan2(moved[1, 0], moved[0, 0])]) / self._period_s
            share = 1 - math.exp(-self._period_s / (_SMOOTH_S / 2))
            self._smoothed = self._smoothed + share * (now - self._smoothed)
            self._speeds = np.asarray(self._speeds + share * (self._smoothed - self._speeds))
        speed_m_s, turn_rad_s = self._speeds
        pitch, roll, up_m = (float(jolt[0]) for jolt in jolts(T_world_base[None], self._robot, self._floor))
        pitch -= settings.pitch_rad_s2_m * (speed_m_s - before_m_s) / self._period_s
        roll += settings.roll_rad_s2_m * speed_m_s * turn_rad_s
        rim_m_s = abs(speed_m_s) + abs(turn_rad_s) * self._robot.track_width_m / 2
        strength = math.sqrt(rim_m_s / settings.speed_m_s)
        angles = strength * self._trembling[:, self._steps % self._trembling.shape[1]]
        sprung = [spring.step(goal) for spring, goal in zip(self._springs, (roll, pitch, up_m), strict=True)]
        self._angles.append(np.array([angles[0] + sprung[0], angles[1] + sprung[1], angles[2], sprung[2]]))
        self._before = T_world_base
        self._steps += 1

    def T_base_body(self, stamps_s: ArrayLike) -> FloatArray:
        """(N, 4, 4) where the body is, at times (N,) of the last second, from where it is on a level floor at rest."""
        stamps_s = np.atleast_1d(np.asarray(stamps_s, float))
        known_s = self._period_s * (self._steps - len(self._angles) + np.arange(len(self._angles)))
        known = np.array(self._angles)
        xi = np.zeros((len(stamps_s), 6))
        for axis, column in zip((3, 4, 5, 2), known.T, strict=True):
            xi[:, axis] = np.interp(stamps_s, known_s, column)
        return np.asarray(se3.exp(xi))


class _Spring:
    """A mass on a spring, at rest at the first goal."""

    def __init__(self, settings: BodySettings, period_s: float) -> None:
        self._b, self._a = spring(settings, period_s)
        self._z = [0.0, 0.0]
        self._rest: float | None = None

    def step(self, goal: float) -> float:
        """Where the mass is once its rest position is `goal`."""
        self._rest = goal if self._rest is None else self._rest
        (b0, b1, b2), (_, a1, a2), (z0, z1) = self._b, self._a, self._z
        x = goal - self._rest
        y = b0 * x + z0
        self._z = [b1 * x - a1 * y + z1, b2 * x - a2 * y]
        return float(y + self._rest)


@dataclass(frozen=True, slots=True)
class MountSettings:
    """How far the mount is off what its calibration says.

    Attributes:
        sigma_m: of the position, along each axis: a few millimetres, by a ruler. Chosen.
        sigma_deg: of the direction, about each axis: tenths of a degree, by a good calibration. Chosen.
    """

    sigma_m: float = 0.003
    sigma_deg: float = 0.2


def mounted(T_base_camera: FloatArray, settings: MountSettings, rng: np.random.Generator) -> FloatArray:
    """T_base_camera (4, 4) as it truly is, of one the calibration has."""
    error = np.concatenate(
        [settings.sigma_m * rng.standard_normal(3), np.radians(settings.sigma_deg) * rng.standard_normal(3)]
    )
    return np.asarray(se3.compose(T_base_camera, se3.exp(error)))


_BOX = 6
_THICKEST_CARPET_M = 0.02
_CELL_M, _MOST_CELLS, _MARGIN_M = 0.02, 4e6, 1.0


@dataclass(frozen=True, slots=True)
class FloorSettings:
    """How high things lie on the floor.

    Attributes:
        threshold_m: (least, most) height of what lies where two areas meet, one for a world; DIN 18040 allows
            wheelchairs 20 mm at most, and asks for none.
        threshold_width_m: half its width.
        carpet_m: height of a carpet. Chosen.
        carpet_edge_m: over which it rises.
        carpet_creep: share of a hard floor's stiffness against creep that tyres have on carpet. Chosen.
        carpet_drag: more rolling resistance there, as a share of the load; carpets double a wheelchair's resistance of
            about 0.015 (van der Woude et al., "Rolling resistance of wheelchairs", 2003).
    """

    threshold_m: tuple[float, float] = (0.002, 0.010)
    threshold_width_m: float = 0.03
    carpet_m: float = 0.006
    carpet_edge_m: float = 0.01
    carpet_creep: float = 0.5
    carpet_drag: float = 0.015


class FloorSurface:
    """Of one world, as a grid of heights.

    Borders of the world's areas have thresholds, and carpets lie on its floor.
    """

    def __init__(self, world: World, settings: FloorSettings, rng: np.random.Generator) -> None:
        low, high = np.array(world.size_m[:2], float) - _MARGIN_M, np.array(world.size_m[2:], float) + _MARGIN_M
        self.settings = settings
        self.cell_m = max(_CELL_M, float(np.sqrt(np.prod(high - low) / _MOST_CELLS)))
        self._low = low
        columns, rows = (np.ceil((high - low) / self.cell_m).astype(int) + 1).tolist()
        lines = [self._cells(area.polygon) for area in world.areas.areas]
        borders, carpets = np.zeros((2, rows, columns), np.uint8)
        cv2.polylines(borders, lines, True, 1)
        # The thin boxes on the floor that look like carpet.
        model, data = world.at_rest()
        for g in range(model.ngeom):
            surface = world.surfaces.get(model.mat(model.geom_matid[g]).name) if model.geom_matid[g] >= 0 else None
            top_m = data.geom_xpos[g, 2] + model.geom_size[g, 2]
            is_flat = model.geom_type[g] == _BOX and 0 < top_m < _THICKEST_CARPET_M
            if surface is None or surface.kind != "carpet" or not is_flat:
                continue
            corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * model.geom_size[g, :2]
            R = data.geom_xmat[g].reshape(3, 3)[:2, :2]
            cv2.fillPoly(carpets, [self._cells(np.asarray(data.geom_xpos[g, :2] + corners @ R.T))], 1)
        self._is_carpet = carpets.astype(bool)
        self.height = _ridge(borders, settings.threshold_width_m, self.cell_m) * np.float32(
            rng.uniform(*settings.threshold_m)
        ) + _ridge(carpets, settings.carpet_edge_m, self.cell_m) * np.float32(settings.carpet_m)

    def height_m(self, xy_m: ArrayLike) -> FloatArray:
        """(...) how high the floor is at places (..., 2)."""
        at = (np.asarray(xy_m, float) - self._low) / self.cell_m
        at = at.clip(0, np.array(self.height.shape[::-1]) - 1.001)
        first = at.astype(np.int64)
        across, along = np.moveaxis(at - first, -1, 0)
        column, row = np.moveaxis(first, -1, 0)
        h = self.height
        near = (1 - across) * h[row, column] + across * h[row, column + 1]
        far = (1 - across) * h[row + 1, column] + across * h[row + 1, column + 1]
        return np.asarray((1 - along) * near + along * far)

    def is_carpet(self, xy_m: ArrayLike) -> BoolArray:
        """(...) whether carpet lies at places (..., 2)."""
        at = np.rint((np.asarray(xy_m, float) - self._low) / self.cell_m).astype(np.int64)
        column, row = np.moveaxis(at.clip(0, np.array(self._is_carpet.shape[::-1]) - 1), -1, 0)
        return np.asarray(self._is_carpet[row, column])

    def _cells(self, outline: FloatArray) -> NDArray[np.int32]:
        return np.rint((np.asarray(outline, float) - self._low) / self.cell_m).astype(np.int32)


def _ridge(marked: ByteArray, width_m: float, cell_m: float) -> Float32Array:
    """(R, C) one at what is marked, and falling beside it by a Gaussian of that half width; no steeper than cells."""
    if not marked.any():
        return np.zeros(marked.shape, np.float32)
    away_m = cv2.distanceTransform(1 - marked, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * np.float32(cell_m)
    return np.asarray(np.exp(-0.5 * (away_m / max(width_m, cell_m)) ** 2), np.float32)


@dataclass(frozen=True, slots=True)
class TyreSettings:
    """How soft tyres are.

    Attributes:
        stiffness_n_m: load that presses a tyre in by a metre: 80 kN/m, as in `BodySettings`.
        rolling_share: how much of that the rolling radius loses; tyres with a stiff tread roll by a radius that lies
            between the free and the loaded one, nearer to the free one (Pacejka, Tire and Vehicle Dynamics, ch. 1).
        settling_s: over which time loads are averaged: contacts of MuJoCo's stiff floor ring, tyres do not. Chosen.
    """

    stiffness_n_m: float = 80_000.0
    rolling_share: float = 0.4
    settling_s: float = 0.1


class LoadedRadii:
    """Rolling radii of wheels, from their loads.

    `radii_m` (W,) are those at the loads at rest, `loads_n` (W,).
    """

    def __init__(self, radii_m: FloatArray, loads_n: FloatArray, settings: TyreSettings) -> None:
        self._radii_m, self._rest_n = np.array(radii_m, float), np.array(loads_n, float)
        self._loads_n = self._rest_n.copy()
        self._settings = settings

    def after(self, loads_n: FloatArray, seconds: float) -> FloatArray:
        """(W,) the radii after so long under loads (W,) in newton."""
        keep = math.exp(-seconds / self._settings.settling_s)
        self._loads_n = keep * self._loads_n + (1 - keep) * np.asarray(loads_n, float)
        pressed_m = self._settings.rolling_share * (self._loads_n - self._rest_n) / self._settings.stiffness_n_m
        return np.asarray(self._radii_m - pressed_m)
