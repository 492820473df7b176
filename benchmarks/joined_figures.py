"""How far answers are from the truth, how often the status is right, and whether covariances hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from benchmarks.joined_cases import Case, Expected
from benchmarks.joined_runs import CAMERA, JOINED, WHEELS, Answers
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Status
from wheelsight.core.geometry import BoolArray, FloatArray, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import Drive

# So long a status may take to notice that something goes wrong, and to be well again.
NOTICE_S, BACK_S = 0.5, 2.0
SLIP_M_S = 0.05
# A camera that is lost for longer is no sensor to compare with.
_COVERAGE = 0.9
_THREE_SIGMA = float(chi2.ppf(chi2.cdf(9.0, 1), 3))
_STANDS_M = 0.001
_OVER_TICKS = 5


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Of one localizer on one drive.

    Attributes:
        rmse_m: of its poses, its first one laid upon the truth; nan without any.
        end_share: error of its last pose as a share of the way driven till then.
        coverage: share of its answers that had a pose.
    """

    rmse_m: float
    end_share: float
    coverage: float


@dataclass(frozen=True, slots=True)
class JoinedFigures:
    """One case on one drive.

    Attributes:
        case, seed: which.
        accuracy: by localizer.
        right: of the answers during which the case asks for a status, how many, and how many of them had it.
        within: of the joined poses, how many, and how many of them lay within three standard deviations.
        back_s: from a blackout's end to the next `tracking`, seconds; None where there is no blackout.
        false_slip: share of the answers that tell a slip while no wheel slips.
    """

    case: Case
    seed: int
    accuracy: Mapping[str, Accuracy]
    right: tuple[int, int]
    within: tuple[int, int]
    back_s: float | None
    false_slip: float

    @property
    def better_m(self) -> float:
        """RMSE of the better single sensor; a camera without a pose for over a tenth of the drive is none."""
        camera = self.accuracy[CAMERA]
        return min(self.accuracy[WHEELS].rmse_m, camera.rmse_m if camera.coverage >= _COVERAGE else math.inf)

    @property
    def ratio(self) -> float:
        """The joined error as a share of the better sensor's."""
        return self.accuracy[JOINED].rmse_m / self.better_m


def figures_of(
    case: Case, seed: int, answers: Mapping[str, Answers], drive: Drive, wheels: Wheels, lasts_s: tuple[float, float]
) -> JoinedFigures:
    """Compare all answers to a drive with its truth.

    Args:
        case, seed: which.
        answers: by localizer.
        drive: with the truth.
        wheels: as they truly are.
        lasts_s: when the case's fault begins and ends.
    """
    joined, truth = answers[JOINED], drive.truth
    slips = slip_spans_s(drive, wheels)
    asked, right = _statuses(case.expected, joined, lasts_s, slips)
    within = _within(joined, truth)
    false = joined.is_flagged("slip") & ~_during(joined.stamps_s, [(a, b + NOTICE_S) for a, b in slips])
    return JoinedFigures(
        case,
        seed,
        {name: accuracy_of(each, truth) for name, each in answers.items()},
        (int(asked.sum()), int((asked & right).sum())),
        (len(within), int(within.sum())),
        _back_s(joined, lasts_s[1]) if case.expected is Expected.COASTING else None,
        float(false.mean()) if len(false) else 0.0,
    )


def accuracy_of(answers: Answers, truth: Trajectory) -> Accuracy:
    """Position error with the first pose laid upon the truth: a best fit would hide what the heading lost."""
    stamps_s, T, _ = _poses(answers, truth)
    if not len(T):
        return Accuracy(math.nan, math.nan, 0.0)
    off_m = np.linalg.norm(_off(T, truth.at(stamps_s)), axis=1)
    way_m = float(np.interp(stamps_s[-1], truth.stamps_s, truth.distances_m))
    end = float(off_m[-1]) / way_m if way_m > 0 else math.nan
    return Accuracy(float(np.sqrt(np.mean(off_m**2))), end, len(answers.posed) / len(answers.estimates))


def errors_m(answers: Answers, truth: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,) of the poses, and how far off each is (N,)."""
    stamps_s, T, _ = _poses(answers, truth)
    return stamps_s, np.linalg.norm(_off(T, truth.at(stamps_s)), axis=1)


def slip_spans_s(drive: Drive, wheels: Wheels) -> list[tuple[float, float]]:
    """When a wheel's rim runs more than 5 cm/s faster or slower than the ground under it, or the base slides sideways.

    Over 0.1 s each. Spans that lie closer than `NOTICE_S` to each other are one.
    """
    ticks = drive.ticks[::_OVER_TICKS]
    stamps_s = np.array([reading.stamp_s for reading in ticks])
    counts = np.array([(reading.left, reading.right) for reading in ticks], float)
    seconds = np.diff(stamps_s)
    rims = np.diff(counts, axis=0) * (wheels.left_m_per_tick, wheels.right_m_per_tick) / seconds[:, None]
    T = drive.truth.at(stamps_s)
    twist = se3.log(se3.invert(T[:-1]) @ T[1:]) / seconds[:, None]
    ground = twist[:, :1] + twist[:, 5:] * wheels.track_width_m / 2 * np.array([-1, 1])
    slips = (np.abs(rims - ground).max(axis=1) > SLIP_M_S) | (np.abs(twist[:, 1]) > SLIP_M_S)
    spans: list[tuple[float, float]] = []
    for index in np.flatnonzero(slips):
        begin_s, end_s = float(stamps_s[index]), float(stamps_s[index + 1])
        if spans and begin_s - spans[-1][1] < NOTICE_S:
            begin_s = spans.pop()[0]
        spans.append((begin_s, end_s))
    return spans


def _poses(answers: Answers, truth: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stamps, poses and covariances of answers that have one and that the truth covers."""
    posed = [e for e in answers.posed if truth.stamps_s[0] <= e.stamp_s <= truth.stamps_s[-1]]
    stamps_s = np.array([estimate.stamp_s for estimate in posed])
    T = np.array([estimate.T_filter_body for estimate in posed]).reshape(-1, 4, 4)
    return stamps_s, T, np.array([estimate.filter_covariance for estimate in posed]).reshape(-1, 6, 6)


def _off(T: FloatArray, T_true: FloatArray) -> FloatArray:
    """(N, 3) true less reported position, in the world that the first pose reported began."""
    T_odom_true = T[0] @ se3.invert(T_true[0])
    return np.asarray((T_odom_true @ T_true)[:, :3, 3] - T[:, :3, 3])


def _within(answers: Answers, truth: Trajectory) -> BoolArray:
    """(N,) which positions lie within three standard deviations; a millimetre more where a base stands, surely so."""
    stamps_s, T, covariances = _poses(answers, truth)
    P = se3.position_covariance(T, covariances) + _STANDS_M**2 * np.eye(3)
    off = _off(T, truth.at(stamps_s))
    return np.asarray(np.einsum("ni,nij,nj->n", off, np.linalg.inv(P), off) <= _THREE_SIGMA)


def _statuses(
    expected: Expected, answers: Answers, lasts_s: tuple[float, float], slips: list[tuple[float, float]]
) -> tuple[BoolArray, BoolArray]:
    """Which answers (N,) are asked for a status, and which have the right one."""
    stamps_s = answers.stamps_s
    if expected is Expected.SLIP:
        return _during(stamps_s, [(a + NOTICE_S, b) for a, b in slips]), answers.is_flagged("slip", "doubtful")
    begin_s, end_s = lasts_s
    asked = _during(stamps_s, [(begin_s if begin_s == 0 else begin_s + NOTICE_S, end_s)])
    if expected is Expected.TRACKING:
        return asked, answers.is_status(Status.TRACKING)
    if expected is Expected.POSED:
        return asked, answers.is_status(Status.TRACKING, Status.COASTING) & ~answers.is_flagged("slip")
    coasts = answers.is_status(Status.COASTING)
    return asked, coasts | answers.is_flagged("degenerate") if expected is Expected.DEGENERATE else coasts


def _during(stamps_s: FloatArray, spans_s: list[tuple[float, float]]) -> BoolArray:
    inside = np.zeros(len(stamps_s), bool)
    for begin_s, end_s in spans_s:
        inside |= (stamps_s >= begin_s) & (stamps_s < end_s)
    return inside


def _back_s(answers: Answers, end_s: float) -> float:
    """From the end of a blackout to the next answer that tracks; infinite without one."""
    back = answers.stamps_s[answers.is_status(Status.TRACKING) & (answers.stamps_s >= end_s)]
    return float(back[0] - end_s) if len(back) else math.inf
