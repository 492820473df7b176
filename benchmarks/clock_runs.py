"""Errors of wheels, camera and both on one drive with a fault of stamps, from where the drive truly began.

Truth is looked up by what an event is, not by its stamp: a frame by its index, a reading by when it was taken. An
answer whose stamp is up to 0.3 s off that of its event is compared with the truth so much earlier or later. One that
says that clocks are apart and has an older stamp is compared where that stamp once was true, or left out where it never
was.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from benchmarks.clock_rows import Row, TimedTicks, timed
from benchmarks.joined_runs import CAMERA, JOINED, WHEELS
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import Recording

ODOMETRY = {WHEELS: "wheels", CAMERA: "dense", JOINED: "wheels,dense"}
# A sensor with poses at fewer of the frames is none to compare with.
COVERAGE = 0.9
TIMES, PLUS_M = 1.2, 0.005
_NEAR_S = 0.3
_THREE_SIGMA = float(chi2.ppf(0.9973, 2))
_STANDS_M = 1e-4


@dataclass(frozen=True, slots=True)
class Errors:
    """Of one localizer on one drive.

    Attributes:
        rmse_m: of its positions; infinite without any.
        posed: share of the events asked about that it has a pose for.
        wrong: of these, how many it is `tracking` at and yet outside 3σ in the plane.
        problem: the exception that ended it, and where.
    """

    rmse_m: float
    posed: float
    wrong: int
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class ClockFigures:
    """A row on one drive."""

    row: str
    seed: int
    errors: dict[str, Errors]

    @property
    def better_m(self) -> float:
        """RMSE of the better sensor alone; infinite where neither has poses enough."""
        alone = (self.errors[name] for name in (WHEELS, CAMERA))
        return min((e.rmse_m for e in alone if e.posed >= COVERAGE and e.problem is None), default=math.inf)

    @property
    def ratio(self) -> float:
        """The joined error as a share of what is allowed; infinite without an answer."""
        joined_m = self.errors[JOINED].rmse_m
        return joined_m if math.isinf(joined_m) else joined_m / (TIMES * self.better_m + PLUS_M)

    @property
    def problems(self) -> list[str]:
        """What ended a localizer."""
        return [e.problem for e in self.errors.values() if e.problem is not None]

    @property
    def is_met(self) -> bool:
        """Whether nothing broke and the joined error is as small as it should be."""
        return not self.problems and self.ratio <= 1


@dataclass(slots=True)
class _Judge:
    """Compares answers with the truth, one after another."""

    truth: Trajectory
    frames_s: dict[int, float]
    reported: list[tuple[float, float]] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    asked: int = 0
    wrong: int = 0

    def true_s(self, event: Event) -> float:
        """When the event truly was."""
        if isinstance(event, TimedTicks):
            return event.true_s
        assert isinstance(event, RgbdFrame)
        return self.frames_s[event.index]

    def hear(self, event: Event) -> None:
        """Note which true time an event's stamp stands for."""
        self.reported.append((event.stamp_s, self.true_s(event)))

    def judge(self, event: Event, answer: Estimate | None) -> None:
        """Count an answer to an event, or that there is none."""
        self.asked += 1
        if answer is None or answer.T_filter_body is None:
            return
        when_s = self._when(event, answer)
        if when_s is None:
            return
        within_s = np.clip(when_s, self.truth.stamps_s[0], self.truth.stamps_s[-1])  # it may be a little off the drive
        off = answer.T_filter_body[:3, 3] - self.truth.at([within_s])[0, :3, 3]
        self.off_m.append(float(np.linalg.norm(off)))
        self.wrong += answer.status is Status.TRACKING and not _covers(answer, off)

    def _when(self, event: Event, answer: Estimate) -> float | None:
        """The true time that an answer speaks of."""
        true_s, late_s = self.true_s(event), answer.stamp_s - event.stamp_s
        if abs(late_s) < _NEAR_S:
            return true_s + late_s
        if answer.reason is not Reason.CLOCKS_APART:
            return true_s
        stamp_s, then_s = min(reversed(self.reported), key=lambda reported: abs(answer.stamp_s - reported[0]))
        return then_s + answer.stamp_s - stamp_s if abs(answer.stamp_s - stamp_s) < _NEAR_S else None

    def errors(self, problem: str | None = None) -> Errors:
        """All in all."""
        rmse_m = float(np.sqrt(np.mean(np.square(self.off_m)))) if self.off_m else math.inf
        return Errors(rmse_m, len(self.off_m) / max(self.asked, 1), self.wrong, problem)


def _covers(answer: Estimate, off: FloatArray) -> bool:
    """Whether 3σ in the plane reach as far."""
    if answer.filter_covariance is None or answer.T_filter_body is None:
        return False
    P = se3.position_covariance(answer.T_filter_body, answer.filter_covariance)[:2, :2] + _STANDS_M**2 * np.eye(2)
    return bool(off[:2] @ np.linalg.solve(P, off[:2]) <= _THREE_SIGMA)


def measure_drive(
    recording: Recording, rows: Sequence[Row], seed: int, on_figures: Callable[[ClockFigures], None]
) -> None:
    """Each row on one drive; the camera alone is asked once about the same frames.

    Args:
        recording: with its truth.
        rows: what is wrong.
        seed: of the drive.
        on_figures: is reported each result as it comes.
    """
    events = timed(recording.events())
    truth = _from_start(recording, events[0].stamp_s)
    frames_s = {event.index: event.stamp_s for event in events if isinstance(event, RgbdFrame)}
    known: dict[tuple[tuple[float, int, int], ...], Errors] = {}
    for row in rows:
        faulty, calibration = row.events(events), row.calibration(recording.calibration)
        frames = [event for event in faulty if isinstance(event, RgbdFrame)]
        seen = tuple((frame.stamp_s, frame.index, id(frame.color)) for frame in frames)
        if seen not in known:
            known[seen] = _errors_of(CAMERA, frames, calibration, _Judge(truth, frames_s))
        errors = {CAMERA: known[seen]}
        for name in (WHEELS, JOINED):
            judge = _Judge(truth, frames_s)
            errors[name] = _errors_of(name, faulty, calibration, judge, row.is_at_readings)
        on_figures(ClockFigures(row.name, seed, errors))


def _from_start(recording: Recording, begin_s: float) -> Trajectory:
    """The base's truth in a world that begins where the drive does."""
    truth = recording.ground_truth
    assert truth is not None
    T_start_odom = se3.invert(truth.at([begin_s])[0])
    return replace(truth, T_frame_body=np.asarray(T_start_odom @ truth.T_frame_body))


def _errors_of(
    name: str, events: Iterable[Event], calibration: Calibration, judge: _Judge, is_at_readings: bool = False
) -> Errors:
    """One localizer over all events, asked at each frame or reading; an exception ends it.

    Wheels alone answer no frames: what they said last counts there, for the reading that they said it of.
    """
    try:
        localizer = Localizer(calibration, load_config(overrides={"odometry": ODOMETRY[name]}))
        last: tuple[Event, Estimate | None] | None = None
        for event in events:
            judge.hear(event)
            answer = localizer.process(event.plain if isinstance(event, TimedTicks) else event)
            is_frame = isinstance(event, RgbdFrame)
            if not is_frame:
                last = (event, answer)
            if is_frame == is_at_readings:
                continue
            if name == WHEELS and is_frame:
                judge.judge(*(last or (event, None)))
            else:
                judge.judge(event, answer)
    except Exception as problem:
        place = traceback.extract_tb(problem.__traceback__)[-1]
        return judge.errors(f"{type(problem).__name__} at {Path(place.filename).name}:{place.lineno}")
    return judge.errors()
