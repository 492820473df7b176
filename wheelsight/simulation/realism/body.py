"""How a body moves on its tyres and springs: it pitches, leans, jolts and trembles, and the camera with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq
from scipy.linalg.blas import dtbsv
from scipy.ndimage import gaussian_filter1d

from wheelsight.geometry import FloatArray, se3
from wheelsight.simulation.realism.floor import Floor
from wheelsight.simulation.robot import Robot
from wheelsight.trajectory import Trajectory

_CASTOR_X_M, _CASTOR_Y_M = 0.45, 0.17
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

    Args:
        truth: T_world_base at a constant rate.
        robot: whose wheels meet the floor.
        floor: what they meet.
        settings: how the body moves.
        rng: of the drive.
    """

    def __init__(
        self, truth: Trajectory, robot: Robot, floor: Floor, settings: BodySettings, rng: np.random.Generator
    ) -> None:
        self._stamps_s = truth.stamps_s
        period_s = float(np.median(np.diff(self._stamps_s)))
        speed_m_s, turn_rad_s = _speeds(truth, period_s)
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


def _speeds(truth: Trajectory, period_s: float) -> tuple[FloatArray, FloatArray]:
    """Forward speed (N,) in m/s and yaw rate (N,) in rad/s."""
    T = truth.T_frame_body
    velocity = np.gradient(T[:, :2, 3], period_s, axis=0)
    yaw_rad = np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))
    forward = np.einsum("ni,ni->n", velocity, np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=-1))
    sigma = _SMOOTH_S / period_s
    return gaussian_filter1d(forward, sigma), gaussian_filter1d(np.gradient(yaw_rad, period_s), sigma)


def jolts(T_world_base: FloatArray, robot: Robot, floor: Floor) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pitch, roll (N,) in radians and rise (N,) in metres of a stiff body whose wheels stand on the floor as it is."""
    half_m = robot.track_width_m / 2
    contacts = np.array(
        [[0, half_m, 0], [0, -half_m, 0], [_CASTOR_X_M, _CASTOR_Y_M, 0], [_CASTOR_X_M, -_CASTOR_Y_M, 0]]
    )
    places = se3.apply(T_world_base, contacts)[..., :2]
    left, right, front_left, front_right = np.moveaxis(floor.height_m(places), -1, 0)
    back_m, front_m = 0.5 * (left + right), 0.5 * (front_left + front_right)
    return (back_m - front_m) / _CASTOR_X_M, (left - right) / (2 * half_m), back_m


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
