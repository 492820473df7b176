"""Drives by wheels and a camera that sees the truth but for what a test does to it, answered by a joined localizer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from drives import Leg, SimulatedDrive
from drives import simulate as roll
from stand_ins import CAMERA, frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate, MotionEstimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate
from wheelsight.core.threads import Stopwatch
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate, Localizer
from wheelsight.vision.dense import DenseEstimate

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, slip_m_per_sqrt_m=0.005)
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0.05], [0, -1, 0, 1.0], [0, 0, 0, 1]])
# Each sight errs by itself: there is nothing that its pixels share.
CALIBRATION = replace(
    Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=T_BASE_CAMERA, source="drive"),
    frame_sigma_m=0.0,
    frame_sigma_rad=0.0,
)
BEND: tuple[Leg, ...] = ((2.0, 0.6, 0.2), (1.5, 0.5, 0.5), (0.5, 0.6, -0.3))
FRAME_LATE_S = 0.001
_READINGS_A_FRAME = 2
_KEYFRAME_M = 0.4
_LEVER = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
_SIGMAS = np.array([1e-3] * 3 + [5e-4] * 3)


@dataclass(frozen=True, eq=False)
class Sight:
    """What a frame shows.

    Attributes:
        blind: why nothing, or None.
        wrong: velocity (vx, vy, ωz) of the base that is seen besides the true one.
        place: number of the place; a camera knows the one where it began.
        hidden: (K, 6) directions (v, ω · 2 m) in the keyframe that are not shown; there the prior is reported.
    """

    blind: Reason | None = None
    wrong: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place: int = 0
    hidden: FloatArray | None = None


class Eye:
    """Camera odometry by keyframes that knows the truth, T_odom_base, and what each stamp's frame shows.

    Attributes:
        taken_s: when frames were taken, by their index, where their stamps do not tell it.
        priors: by stamps, that of the frame tracked before, and the motion since then that was to be expected.
        restarts: by stamps, the poses T_odom_camera that it was reported to go on at.
    """

    def __init__(
        self,
        truth: Trajectory,
        sight: Callable[[float], Sight] = lambda stamp_s: Sight(),
        T_base_camera: FloatArray = T_BASE_CAMERA,
    ) -> None:
        self._truth, self._sight, self._T_base_camera = truth, sight, T_base_camera
        self._rng = np.random.default_rng(7)
        self._key: tuple[float, FloatArray] | None = None  # stamp and T_odom_camera
        self._last: tuple[float, FloatArray] | None = None
        self._place, self._wrong, self._T_first = 0, np.eye(4), T_base_camera
        self.watch, self.store = Stopwatch(), KeyframeStore()
        self.priors: dict[float, tuple[float, FloatArray | None]] = {}
        self.others: dict[float, tuple[FloatArray | None, ...]] = {}
        self.restarts: dict[float, FloatArray] = {}
        self.taken_s: dict[int, float] = {}

    def T_odom_camera(self, stamp_s: float) -> FloatArray:
        """The truth (4, 4)."""
        known_s = np.clip(np.nan_to_num(stamp_s), *self._truth.stamps_s[[0, -1]])
        return np.asarray(self._truth.at([known_s])[0] @ self._T_base_camera)

    def process(
        self,
        frame: RgbdFrame,
        T_previous_current_prior: FloatArray | None = None,
        *others: FloatArray | None,
        twist: FloatArray | None = None,
    ) -> Estimate:
        frame = replace(frame, stamp_s=self.taken_s.get(frame.index, frame.stamp_s))
        shows = self._sight(frame.stamp_s)
        if self._last is None and shows.blind is None:
            return self._begin(frame.stamp_s, self._T_first)
        if self._last is None or self._key is None or shows.blind is not None or shows.place != self._place:
            return self._fail(shows.blind or Reason.NOT_RECOGNISED, frame.stamp_s)
        self.priors[frame.stamp_s] = self._last[0], T_previous_current_prior
        self.others[frame.stamp_s] = others
        T_key_now, T_odom_key = self._look(shows, frame.stamp_s), self._key[1]
        T_prior = T_previous_current_prior
        T_key_prior = None if T_prior is None else se3.invert(T_odom_key) @ self._last[1] @ T_prior
        motion = _judged(T_key_now, T_key_prior, shows.hidden)
        assert motion.T_reference_current is not None
        T_key_now = motion.T_reference_current
        self._last = frame.stamp_s, se3.nearest(T_odom_key @ T_key_now)
        if np.linalg.norm(T_key_now[:3, 3]) > _KEYFRAME_M:
            self._key, self._wrong = self._last, np.eye(4)
        return self._tracking(frame.stamp_s, motion)

    def restart(self, frame: RgbdFrame, T_odom_camera: FloatArray, covariance: FloatArray) -> Estimate:
        frame = replace(frame, stamp_s=self.taken_s.get(frame.index, frame.stamp_s))
        self.restarts[frame.stamp_s] = T_odom_camera
        self._place = self._sight(frame.stamp_s).place
        return self._begin(frame.stamp_s, T_odom_camera)

    def begin_at(self, T_map_camera: FloatArray) -> None:
        self._T_first = T_map_camera

    def miss(self, stamp_s: float) -> Estimate:
        return self._fail(Reason.FRAME_UNUSABLE, stamp_s)

    def _look(self, shows: Sight, stamp_s: float) -> FloatArray:
        """Against the keyframe. What is seen wrongly adds up from frame to frame until frames are right again."""
        assert self._key is not None
        assert self._last is not None
        vx, vy, turn = np.multiply(shows.wrong, stamp_s - self._last[0])
        self._wrong = self._wrong @ se3.exp([vx, vy, 0, 0, 0, turn]) if any(shows.wrong) else np.eye(4)
        wrong = se3.invert(self._T_base_camera) @ self._wrong @ self._T_base_camera
        T = se3.invert(self.T_odom_camera(self._key[0])) @ self.T_odom_camera(stamp_s)
        return np.asarray(se3.exp(_SIGMAS * self._rng.standard_normal(6)) @ T @ wrong)

    def _begin(self, stamp_s: float, T_odom_camera: FloatArray) -> Estimate:
        self._key = self._last = stamp_s, T_odom_camera
        return self._tracking(stamp_s, MotionEstimate(np.eye(4), 1e-12 * np.eye(6)))

    def _tracking(self, stamp_s: float, motion: MotionEstimate) -> Estimate:
        assert self._last is not None
        reported = (Status.TRACKING, self._last[1], 1e-6 * np.eye(6))
        return DenseEstimate(stamp_s, *reported, matches=200, inliers=160, motion=motion)

    def _fail(self, reason: Reason, stamp_s: float) -> Estimate:
        status = Status.INITIALIZING if self._last is None else Status.FAILING
        return DenseEstimate(stamp_s, status, reason=reason, motion=MotionEstimate.failed(reason))


def _judged(T: FloatArray, T_prior: FloatArray | None, hidden: FloatArray | None) -> MotionEstimate:
    """The motion as dense odometry shows it: in hidden directions, the prior's."""
    covariance = np.diag(_SIGMAS**2)
    if hidden is None:
        return MotionEstimate(T, covariance, None, 200, 160)
    T_prior = T if T_prior is None else T_prior
    seen = np.linalg.svd(hidden)[2][len(hidden) :]
    off = _LEVER * se3.log(T @ se3.invert(T_prior))
    T = se3.exp(seen.T @ seen @ off / _LEVER) @ T_prior
    wide = hidden / _LEVER
    return MotionEstimate(T, covariance + 0.01 * wide.T @ wide, None, 200, 160, hidden)


@dataclass
class MapOfFrames:
    """Stands for a mapper: keeps which frames were fused, and where, and whether the map is tracked against."""

    fused: dict[float, FloatArray] = field(default_factory=dict)
    map: None = None
    is_tracked: bool = False

    def track_map(self, tracks: bool) -> None:
        self.is_tracked = tracks

    def fuse_tracked(self, frame: RgbdFrame, seen: Estimate) -> None:
        assert seen.T_odom_body is not None
        self.fused[frame.stamp_s] = seen.T_odom_body


@dataclass(frozen=True)
class Drive:
    """Readings and truth, and the frames between: each a millisecond after a reading."""

    readings: SimulatedDrive
    faults: Callable[[float], Sight] = lambda stamp_s: Sight()

    @property
    def truth(self) -> Trajectory:
        return self.readings.truth

    @property
    def begin_s(self) -> float:
        return float(self.readings.stamps_s[0])

    def events(self) -> list[Event]:
        ticks = zip(self.readings.stamps_s.tolist(), self.readings.left, self.readings.right, strict=True)
        given: list[Event] = []
        for index, (stamp_s, left, right) in enumerate(ticks):
            given.append(WheelTicks(stamp_s, int(left), int(right)))
            if index % _READINGS_A_FRAME == 0 and index + 1 < len(self.readings.stamps_s):
                number = index // _READINGS_A_FRAME
                given.append(replace(frame(number % 200, stamp_s + FRAME_LATE_S), index=number))
        return given

    def eye(self) -> Eye:
        """What sees it; faults are given by seconds since the begin."""
        return Eye(self.truth, lambda stamp_s: self.faults(stamp_s - self.begin_s))


def eye_by_index(made: Drive) -> Eye:
    """What sees a drive whatever stamps its frames get."""
    eye = made.eye()
    eye.taken_s = {event.index: event.stamp_s for event in made.events() if isinstance(event, RgbdFrame)}
    return eye


def drive(
    legs: Sequence[Leg] = BEND, faults: Callable[[float], Sight] = lambda seconds: Sight(), seed: int = 3
) -> Drive:
    """With wheels that slip a little, as their calibration says."""
    return Drive(roll(WHEELS, legs, rng=np.random.default_rng(seed), start_s=100.0), faults)


def spinning(made: Drive, begin_s: float, end_s: float, speed_m_s: float) -> Drive:
    """The same drive, its wheels counting so much speed that is no way, for a while."""
    seconds = np.clip(made.readings.stamps_s - made.begin_s, begin_s, end_s) - begin_s
    extra = np.round(seconds * speed_m_s / WHEELS.left_m_per_tick).astype(np.int64)
    left, right = made.readings.left + extra, made.readings.right + extra
    return replace(made, readings=replace(made.readings, left=left, right=right))


def pushed(made: Drive, at_s: float, left_m: float) -> Drive:
    """The same drive, but somebody moves the robot aside within a sixth of a second, of which no wheel shows."""
    truth = made.truth
    aside = np.zeros((len(truth), 6))
    aside[:, 1] = left_m * np.clip((truth.stamps_s - made.begin_s - at_s) / 0.16, 0, 1)
    T_odom_then = truth.at([made.begin_s + at_s])[0]
    T_odom_moved = T_odom_then @ se3.exp(aside) @ se3.invert(T_odom_then) @ truth.T_frame_body
    moved = Trajectory(truth.stamps_s, T_odom_moved, body="base")
    return replace(made, readings=replace(made.readings, truth=moved))


def yaw_rates(made: Drive, bias_rad_s: float = 0.0) -> list[YawRate]:
    """What a gyroscope shows at each reading but the first, a little before it."""
    T, stamps_s = made.truth.T_frame_body, made.truth.stamps_s
    turned = se3.invert(T[:-1]) @ T[1:]
    rates = np.arctan2(turned[:, 1, 0], turned[:, 0, 0]) / np.diff(stamps_s) + bias_rad_s
    return [YawRate(float(s) - 1e-4, float(rate)) for s, rate in zip(stamps_s[1:], rates, strict=True)]


def joined(
    monkeypatch: pytest.MonkeyPatch,
    eye: Eye,
    kind: str = "dense",
    calibration: Calibration = CALIBRATION,
    **settings: Any,
) -> tuple[Localizer, MapOfFrames]:
    """A localizer by wheels and this eye, which stands for odometry of that kind, and its map."""
    kept = MapOfFrames()
    dense = Eye if kind == "dense" else type("Dense", (), {})
    for module in ("camera_localizer", "fusion_localizer"):
        monkeypatch.setattr(f"wheelsight.estimation.{module}.DenseOdometry", dense)
    camera = (eye, kept if kind == "dense" else None)
    monkeypatch.setattr("wheelsight.estimation.camera_localizer.camera_odometry", lambda *_: camera)
    return Localizer(calibration, load_config(overrides={"odometry": f"wheels,{kind}"} | settings)), kept


def answers_to(subject: Localizer, events: Iterable[Event]) -> list[tuple[Event, FusedEstimate]]:
    """Each event that was answered, with its answer."""
    given = ((event, subject.process(event)) for event in events)
    return [(event, answer) for event, answer in given if isinstance(answer, FusedEstimate)]


def of_frames(answers: Iterable[tuple[Event, FusedEstimate]]) -> list[FusedEstimate]:
    """The answers to frames."""
    return [answer for event, answer in answers if isinstance(event, RgbdFrame)]


def off_m(answer: Estimate, truth: Trajectory, stamp_s: float | None = None) -> float:
    """Metres between the answer's pose and the truth, which ends where the robot stands."""
    assert answer.T_filter_body is not None, f"no pose: {answer.reason}"
    T = truth.at([min(answer.stamp_s if stamp_s is None else stamp_s, truth.stamps_s[-1])])[0]
    return float(np.linalg.norm(answer.T_filter_body[:3, 3] - T[:3, 3]))


def spread_m(answer: Estimate) -> float:
    """The position's standard deviation in the plane."""
    assert answer.T_odom_body is not None
    assert answer.covariance is not None
    x, y, z = answer.T_odom_body[:3, 3]
    J = np.array([[1.0, 0, 0, 0, z, -y], [0, 1.0, 0, -z, 0, x]])
    return float(np.sqrt(np.trace(J @ answer.covariance @ J.T)))
