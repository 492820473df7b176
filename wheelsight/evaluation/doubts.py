"""What two trajectories say of a mistake in one of their files: units of stamps, the order of quaternions."""

from __future__ import annotations

import numpy as np

from wheelsight.association import associate
from wheelsight.evaluation.coverage import pairing_warning
from wheelsight.geometry import FloatArray, so3
from wheelsight.stamps import NUMBERS, UNITS, StampUnit, unit_of
from wheelsight.trajectory import Trajectory

ESTIMATE, TRUTH = "estimate", "ground truth"
# Two files of one drive reach over the same time, within such a factor.
_SAME_SPAN = 1.5
# Turns between compared poses, where they are large enough to tell axes: radians, and how many.
_LEAST_TURN_RAD, _FEWEST_TURNS = 0.15, 5
# Turns are told wrongly by so much of themselves, and by so little once the order of four numbers is changed.
_WRONG_SHARE, _RIGHT_SHARE = 0.6, 0.2
_FIRST_W_OF_XYZW = [1, 2, 3, 0]


def doubts_of(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> tuple[str, ...]:
    """A sentence for each mistake that the two seem to hold; few if any."""
    if estimate.body != truth.body or not len(estimate) or not len(truth):
        return ()
    pairs = associate(estimate.stamps_s, truth.stamps_s, max_gap_s)
    of_units = _unit_doubts(estimate, truth, are_paired=2 * len(pairs) >= min(len(estimate), len(truth)))
    few = _pairing_doubt(estimate, truth, len(pairs), max_gap_s, is_explained=bool(of_units))
    order = None if of_units else _order_doubt(estimate.select(pairs[:, 0]), truth.select(pairs[:, 1]))
    return tuple(filter(None, (*of_units, few, order)))


def _unit_doubts(estimate: Trajectory, truth: Trajectory, *, are_paired: bool) -> list[str]:
    """By how much longer one is than the other, unless most poses are paired; else by the stamps of each alone."""
    given = {ESTIMATE: estimate.stamps_s, TRUTH: truth.stamps_s}
    units = {name: unit for name, stamps in given.items() if (unit := unit_of(stamps)) is not None}
    if len(units) == 2 and len(set(units.values())) == 1:
        return [f"The stamps of both look like {_kind(units[TRUTH])}, not seconds: a second in these figures is none."]
    if not are_paired:
        units = _unit_by_span(given) or units
    return [_unit_sentence(name, units[name], given[name]) for name in units]


def _unit_by_span(given: dict[str, FloatArray]) -> dict[str, StampUnit]:
    spans = {name: float(np.ptp(stamps)) for name, stamps in given.items()}
    (short, long) = sorted(spans, key=lambda name: spans[name])
    for unit in UNITS:
        assert unit.per_second is not None
        if spans[short] > 0 and 1 / _SAME_SPAN < spans[long] / spans[short] / unit.per_second < _SAME_SPAN:
            return {long: unit}
    return {}


def _unit_sentence(name: str, unit: StampUnit, stamps: FloatArray) -> str:
    by = "the poses a second" if unit.per_second is None else f"{unit.per_second:.0f}"
    span = f"{stamps[0]:.15g} to {stamps[-1]:.15g}"
    return f"The {name}'s stamps ({span}) look like {_kind(unit)}, not seconds: divide them by {by}."


def _kind(unit: StampUnit) -> str:
    return "numbers of poses" if unit is NUMBERS else unit.name


def _pairing_doubt(
    estimate: Trajectory, truth: Trajectory, pairs: int, max_gap_s: float, *, is_explained: bool
) -> str | None:
    """That few poses are compared, though both tell of them; another unit explains it, and no gap mends it then."""
    if is_explained:
        count = min(len(estimate), len(truth))
        few = f"Only {pairs} of {len(estimate)} poses have a true one within {max_gap_s:g} s, and errors are of these."
        return few if 2 * pairs < count else None
    return pairing_warning(estimate, truth, pairs, max_gap_s)


def _order_doubt(estimate: Trajectory, truth: Trajectory) -> str | None:
    """That turns, told about wrong axes, would be right if the four numbers of one file began with w, not x.

    Angles between poses do not change with the order, axes do. `estimate` and `truth` are M pairs.
    """
    R_estimate, R_truth = (t.T_frame_body[:, :3, :3] for t in (estimate, truth))
    first, second = _turns(R_truth)
    if len(first) < _FEWEST_TURNS:
        return None
    turn_rad = float(np.median(so3.angle(_between(R_truth, first, second))))

    def off(R_a: FloatArray, R_b: FloatArray) -> float:
        a, b = _between(R_a, first, second), _between(R_b, first, second)
        return float(np.median(so3.angle(np.swapaxes(a, 1, 2) @ b))) / turn_rad

    if off(R_estimate, R_truth) < _WRONG_SHARE:
        return None
    mended = {ESTIMATE: off(_reordered(R_estimate), R_truth), TRUTH: off(R_estimate, _reordered(R_truth))}
    likely = [name for name, share in mended.items() if share < _RIGHT_SHARE]
    if not likely:
        return None
    return f"Quaternions of the {' or of the '.join(likely)} seem to be written qw qx qy qz: write qx qy qz qw."


def _turns(R: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (K,), (K,) of places in R (M, 3, 3), as near as each other as shows a turn at some of them."""
    count = len(R)
    step = 1
    while step < count:
        first = np.arange(count - step)
        enough = so3.angle(_between(R, first, first + step)) > _LEAST_TURN_RAD
        if np.count_nonzero(enough) >= _FEWEST_TURNS:
            return first[enough], first[enough] + step
        step *= 2
    return np.empty(0, int), np.empty(0, int)


def _between(R: FloatArray, first: np.ndarray, second: np.ndarray) -> FloatArray:
    return np.asarray(np.swapaxes(R[first], 1, 2) @ R[second])


def _reordered(R: FloatArray) -> FloatArray:
    """Rotations (M, 3, 3) by quaternions whose first number, read as x, is w."""
    return so3.from_quaternion(so3.to_quaternion(R)[:, _FIRST_W_OF_XYZW])
