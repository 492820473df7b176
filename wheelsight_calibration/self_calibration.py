"""`calibrate_self` returns a robot's calibration by an ordinary drive: from its map, its wheels and its gyroscope.

What the drive does not determine keeps its value. A part is taken only if it explains pairs of views better that the
fit did not use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, MapError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import BoolArray, FloatArray, IntArray, se3
from wheelsight.core.inputs import is_there
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import YawRate
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.slam.maps import MapFolder, find_map
from wheelsight.slam.maps.contents import in_largest_piece, new_numbers, renumbered
from wheelsight_calibration.self_model import RobotModel
from wheelsight_calibration.self_solver import JointFit, JointProblem, MapData
from wheelsight_calibration.self_views import Patches, PatchPair, on_floor, overlapping, patches_of
from wheelsight_calibration.solver import robust_weights
from wheelsight_calibration.wheel_drive import drive_of

Progress = Callable[[str, int, int], None]

# Chosen: views that are used at most, spread over the drive; partners of each; the fewest that a calibration takes.
_MOST_VIEWS, _PARTNERS, _FEWEST_VIEWS, _FEWEST_PAIRS = 240, 8, 12, 30
_HELD_OUT = 5  # of as many pairs, and of as many steps, one is not used
_FLOOR_DEG, _FLOOR_M = 6.0, 0.10  # from the floor by the mount as it was
_LONGEST_STEP_S, _LEAST_STEP = 20.0, 0.02  # of a step between views; its way in metres or turn in radians
# A share of information below which a parameter counts as not shown, and a gain in units of its own σ that counts. Of
# four simulated drives, two gained 8 and 9 and came nearer to the truth, two gained 3 and did not.
LEAST_SHARE, _LEAST_GAIN = 0.25, 5.0
_LEAST_INLIERS = 0.5  # share of matched patches within 4 σ
# A camera that was moved: the floor's change between the two parts of a drive, in degrees and metres, and in σ.
_MOVED_DEG, _MOVED_M, _MOVED_SIGMAS, _FEWEST_FLOORS = 0.5, 0.02, 6.0, 16
_SURPRISE = 3.0  # σ of a prior, beyond which nothing is taken
_WORSE = 1.05  # of the motions by wheels, after over before
_JUDGED_M, _MOST_FITS = 0.10, 3  # gate of held-out patches; fits, each without what the one before did not show
_MOST_SURPRISE = 3.0  # mean square of all values in σ of their prior; a larger one is no unit of this robot. Chosen


class HeldOut(NamedTuple):
    """Errors on what the fit did not use, before and after.

    Attributes:
        before, after: RMS, robust.
        gain: mean fall of the robust cost over its standard error.
        number: of pairs or steps.
    """

    before: float
    after: float
    gain: float
    number: int

    @property
    def is_better(self) -> bool:
        """Whether the fall is significant."""
        return self.number > 0 and self.gain > _LEAST_GAIN


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """A robot's calibration by an ordinary drive.

    Attributes:
        source: name of the map.
        model: parameters and their priors.
        values: (P,) changes that are taken.
        covariance: (P, P) of all parameters.
        shares: (P,) share of information from this drive, 1 - σ²/σ² of the prior.
        taken: (P,) which parameters changed.
        views, pairs: numbers of keyframes and of pairs.
        held_out_pairs: distances between patches of the held-out pairs, in metres.
        held_out_steps: errors of the base's motions, in σ; None without wheels.
        off_m: (2, K) distances of held-out patches before and after, and `distances_m` (K,) from the farther view.
        plans_m: two (K, 2) of walls from above, before and after, in the map.
        reasons: sentences on what is not taken, and why.
    """

    source: str
    model: RobotModel
    values: FloatArray
    covariance: FloatArray
    shares: FloatArray
    taken: BoolArray
    views: int
    pairs: int
    held_out_pairs: HeldOut
    held_out_steps: HeldOut | None
    off_m: FloatArray
    distances_m: FloatArray
    plans_m: tuple[FloatArray, FloatArray]
    reasons: tuple[str, ...]

    @property
    def is_better(self) -> bool:
        """Whether anything is taken."""
        return bool(self.taken.any())

    @property
    def calibration(self) -> Calibration:
        """The calibration with what is taken."""
        return self.model.calibrated(self.values, self.covariance)


def calibrate_self(
    folder: StrPath,
    *,
    wheels: StrPath | None = None,
    is_mount_measured: bool = False,
    sensor: str | None = None,
    on_step: Progress = lambda what, done, total: None,
) -> SelfCalibration:
    """Estimate a robot's calibration from the map of an ordinary drive.

    Args:
        folder: a map, or the folder of a run or a drive with one.
        wheels: a recording of the drive with its wheels; None to search in `folder`.
        is_mount_measured: whether a drive measured the mount before, which narrows its prior.
        sensor: "structured-light", "tof" or "stereo"; None to decide by the calibration.
        on_step: called with the current task, the number of finished parts, and their total.

    Raises:
        MapError: no map, or one without keyframes.
        CalibrationError: too few views, a camera that moved on the robot, or hardly any surfaces that agree.
    """
    path = find_map(folder)
    opened = MapFolder.open(path)
    recording = _recording_beside(Path(folder), wheels)
    calibration = opened.calibration
    has_wheels = recording is not None and calibration.wheels is not None
    gyro = _yaw_rates(recording) if has_wheels else None
    options = {"has_wheels": has_wheels, "has_gyro": gyro is not None, "is_mount_measured": is_mount_measured}
    model = RobotModel.of(calibration, sensor=sensor, **options)
    data = data_of(opened, model, recording if model.has_wheels else None, gyro, on_step)
    found = calibrated_by(data, model, on_step)
    notes = [] if model.has_mount else ["The calibration has no mount: mount, wheels and gyroscope stay as they are."]
    if model.has_mount and not model.has_wheels:
        notes.append("No wheel readings lie beside the map: wheels, their delay and the scale by them stay.")
    return replace(found, source=str(folder), reasons=(*notes, *found.reasons))


def _recording_beside(folder: Path, wheels: StrPath | None) -> Recording | None:
    """The recording with the wheels of a map's drive: given, or that of `wheelsight drive --out`."""
    if wheels is not None:
        return open_recording(Path(wheels))
    beside = [folder / "wheels", folder.parent / "wheels", folder]
    found = next((one for one in beside if is_there(one / "wheels.csv")), None)
    return None if found is None else open_recording(found)


def _yaw_rates(recording: Recording | None) -> tuple[FloatArray, FloatArray] | None:
    """Stamps and yaw rates (K,) of a recording, or None without."""
    if recording is None:
        return None
    rates = [(one.stamp_s, one.yaw_rate_rad_s) for one in recording.events(images=False) if isinstance(one, YawRate)]
    if len(rates) < 2:
        return None
    stamps_s, values = np.array(rates).T
    return stamps_s, values


def data_of(
    opened: MapFolder,
    model: RobotModel,
    recording: Recording | None,
    gyro: tuple[FloatArray, FloatArray] | None,
    on_step: Progress,
) -> MapData:
    """Return what a map holds. Raises MapError without keyframes, and CalibrationError for too few."""
    calibration = opened.calibration
    together = np.flatnonzero(in_largest_piece(opened))
    if not len(together):
        raise MapError("has no keyframes", path=opened.path, fix="drive again, and let the robot end its map")
    kept = together[np.unique(np.linspace(0, len(together) - 1, min(len(together), _MOST_VIEWS)).round().astype(int))]
    views, used = list[Patches](), list[int]()
    for done, number in enumerate(kept.tolist(), start=1):
        view = patches_of(opened.store[KeyframeId(number)], calibration)
        if len(view) >= _FEWEST_PAIRS:
            views.append(view)
            used.append(number)
        on_step("reading", done, len(kept))
    if len(views) < _FEWEST_VIEWS:
        problem = f"{len(views)} of {len(kept)} keyframes show flat surfaces, {_FEWEST_VIEWS} are needed"
        raise CalibrationError(problem, path=opened.path, fix="drive further, past walls one to four metres away")
    T = opened.store.T_map_keyframe[used]
    pairs = overlapping(views, T, _PARTNERS, lambda done: on_step("pairs", done + 1, len(views)))
    edges = renumbered(opened.edges, new_numbers(np.array(used), len(opened.store)))
    floors: tuple[IntArray, ...] = ()
    if model.has_mount:
        mount = calibration.T_base_camera
        assert mount is not None
        floors = tuple(np.flatnonzero(on_floor(view, mount, _FLOOR_DEG, _FLOOR_M)) for view in views)
    stamps_s = np.array([view.stamp_s for view in views])
    drive = None if recording is None or calibration.wheels is None else drive_of(recording, calibration.wheels)
    steps = _steps_of(stamps_s, T, drive.stamps_s if drive is not None else None) if model.has_mount else _NO_STEPS
    turned = np.zeros(0)
    if gyro is not None:
        turned = _turns(gyro, stamps_s[steps], calibration.gyro.bias_rad_s)
    return MapData(tuple(views), T, tuple(pairs), floors, edges, steps, drive, turned)


_NO_STEPS = np.zeros((0, 2), np.int64)


def _steps_of(stamps_s: FloatArray, T: FloatArray, readings_s: FloatArray | None) -> IntArray:
    """(S, 2) neighbouring views in time between which the robot moved, within the time of the readings."""
    order = np.argsort(stamps_s, kind="stable")
    steps = np.stack([order[:-1], order[1:]], axis=1)
    seconds = stamps_s[steps[:, 1]] - stamps_s[steps[:, 0]]
    moved = se3.log(se3.invert(T[steps[:, 0]]) @ T[steps[:, 1]])
    size = np.maximum(np.linalg.norm(moved[:, :3], axis=1), np.linalg.norm(moved[:, 3:], axis=1))
    kept = (seconds > 0) & (seconds < _LONGEST_STEP_S) & (size > _LEAST_STEP)
    if readings_s is not None:
        kept &= (stamps_s[steps[:, 0]] > readings_s[0] + 0.1) & (stamps_s[steps[:, 1]] < readings_s[-1] - 0.1)
    return np.asarray(steps[kept], np.int64)


def _turns(gyro: tuple[FloatArray, FloatArray], spans_s: FloatArray, bias_rad_s: float) -> FloatArray:
    """(S,) turns between stamps (S, 2); NaN where readings are missing."""
    stamps_s, rates = gyro
    yaw = np.concatenate([[0.0], np.cumsum((rates[1:] + rates[:-1]) / 2 * np.diff(stamps_s))])
    ends = np.interp(spans_s, stamps_s, yaw, left=np.nan, right=np.nan)
    return np.asarray(ends[:, 1] - ends[:, 0] - bias_rad_s * (spans_s[:, 1] - spans_s[:, 0]))


def calibrated_by(
    data: MapData, model: RobotModel, on_step: Progress = lambda what, done, total: None
) -> SelfCalibration:
    """`calibrate_self` for data that were read. Raises CalibrationError."""
    held = [pair for number, pair in enumerate(data.pairs) if number % _HELD_OUT == _HELD_OUT - 1]
    used = [pair for number, pair in enumerate(data.pairs) if number % _HELD_OUT != _HELD_OUT - 1]
    if len(used) < _FEWEST_PAIRS:
        problem = f"{len(used)} pairs of views share surfaces, {_FEWEST_PAIRS} are needed"
        raise CalibrationError(problem, fix="drive on, and come past the same walls from near and far")
    _refuse_if_moved(data, model)
    held_steps = np.arange(len(data.steps)) % _HELD_OUT == _HELD_OUT - 1
    learned = replace(
        data, steps=data.steps[~held_steps], yaw_rad=data.yaw_rad[~held_steps] if len(data.yaw_rad) else data.yaw_rad
    )
    free = np.ones(len(model), bool)
    first = JointProblem(model, learned, ~free).fit(used, on_round=lambda k, n: on_step("as it was", k, n))
    _refuse_if_apart(JointProblem(model, learned, free), first)
    found: JointFit | None = None
    for _ in range(_MOST_FITS):
        found = JointProblem(model, learned, free).fit(used, found, lambda k, n: on_step("calibrating", k, n))
        shares = 1 - np.diag(found.covariance) / np.diag(model.prior)
        unseen = free & (shares < LEAST_SHARE) & ~_is_shared(model)
        if not unseen.any():
            break
        free = free & ~unseen
    assert found is not None
    on_step("checking", 1, 1)
    return _decided(data, model, found, free, _judged(JointProblem(model, data, free), held, held_steps, first, found))


class _Judged(NamedTuple):
    """Pairs and steps that the fit did not use; distances of patches, see `SelfCalibration`; walls."""

    pairs: HeldOut
    steps: HeldOut | None
    off_m: FloatArray
    distances_m: FloatArray
    plans_m: tuple[FloatArray, FloatArray]


def _judged(
    problem: JointProblem,
    held: Sequence[tuple[int, int]],
    held_steps: BoolArray,
    first: JointFit,
    found: JointFit,
) -> _Judged:
    zero = np.zeros_like(found.values)
    matches = [problem.match(i, j, first.T_map_camera, zero, _JUDGED_M) for i, j in held]
    matches = [match for match in matches if len(match.of_first)]
    of_pairs, off_m, distances_m = _judged_pairs(problem, matches, first, found)
    of_steps = _judged_steps(problem, held_steps, first, found) if problem.model.has_wheels else None
    before, after = (problem.walls_m(fit.values, fit.T_map_camera) for fit in (first, found))
    return _Judged(of_pairs, of_steps, off_m, distances_m, (before, after))


def _decided(data: MapData, model: RobotModel, found: JointFit, free: BoolArray, judged: _Judged) -> SelfCalibration:
    shares = np.where(free, 1 - np.diag(found.covariance) / np.diag(model.prior), 0.0)
    reasons, pairs, steps = list[str](), judged.pairs, judged.steps
    P = model.prior + 1e-14 * np.eye(len(model))
    surprise = float(found.values @ np.linalg.solve(P, found.values)) / len(model)
    if not pairs.is_better:
        reasons.append(
            f"On {pairs.number} pairs of views that it did not use, the result is not surely better "
            f"({1e3 * pairs.before:.1f} mm before, {1e3 * pairs.after:.1f} mm after): nothing is taken."
        )
    elif steps is not None and steps.after > _WORSE * steps.before:
        reasons.append(
            f"The motions by wheels agree no better with the camera ({steps.before:.2f} σ before, "
            f"{steps.after:.2f} σ after): nothing is taken."
        )
    elif surprise > _MOST_SURPRISE:
        reasons.append(
            f"The values lie {np.sqrt(surprise):.1f} σ from what data sheets say, in the mean: nothing is taken. Is it "
            "the map of another robot, or did wheels slip for long?"
        )
    # Lens and mount have a ruler and a data sheet; a curve or pattern has many small parts.
    sigmas = np.sqrt(np.diag(model.prior))
    is_far = free & (np.abs(found.values) > _SURPRISE * sigmas) & ~_is_shared(model)
    if is_far.any() and not reasons:
        names = ", ".join(model.names[k].removesuffix("_s").replace("_", " ") for k in np.flatnonzero(is_far))
        reasons.append(
            f"More than {_SURPRISE:g} σ from what was known: {names}; nothing is taken. Measure the mount by a ruler "
            "again; if it is right, the drive does not suffice."
        )
    taken = free & (found.values != 0) & (not reasons)
    return SelfCalibration(
        source="",
        model=model,
        values=np.where(taken, found.values, 0.0),
        covariance=found.covariance,
        shares=shares,
        taken=taken,
        views=len(data.views),
        pairs=len(data.pairs),
        held_out_pairs=pairs,
        held_out_steps=steps,
        off_m=judged.off_m,
        distances_m=judged.distances_m,
        plans_m=judged.plans_m,
        reasons=tuple(reasons),
    )


def _is_shared(model: RobotModel) -> BoolArray:
    """(P,) parameters of one curve or pattern, which stay together, and of the map."""
    return np.array([name.startswith(("depth_pattern", "depth_curve", "map_")) for name in model.names])


def _judged_pairs(
    problem: JointProblem, matches: Sequence[PatchPair], first: JointFit, found: JointFit
) -> tuple[HeldOut, FloatArray, FloatArray]:
    """Held-out pairs before and after: poses of the fit without and with calibration, the same patches."""
    zero = np.zeros_like(found.values)
    falls, offs, squares, distances = [], [], [], []
    for pair in matches:
        fits = ((zero, first), (found.values, found))
        before, after = (problem.off_m(pair, values, fit.T_map_camera) for values, fit in fits)
        sigmas = np.stack([problem.sigma_m(pair, values) for values, _ in fits])
        chi2 = (np.stack([before, after]) / (3 * sigmas)) ** 2
        cost = chi2 * np.sqrt(robust_weights(chi2))  # Geman and McClure's
        falls.append(float((cost[0] - cost[1]).mean()))
        offs.append(np.stack([before, after]))
        a, b = problem.data.views[pair.first], problem.data.views[pair.second]
        distances.append(np.maximum(a.depth_m[pair.of_first], b.depth_m[pair.of_second]))
        squares.append([np.median(np.abs(before)), np.median(np.abs(after))])
    if not falls:
        return HeldOut(0.0, 0.0, 0.0, 0), np.zeros((2, 0)), np.zeros(0)
    rms = 1.4826 * np.sqrt((np.array(squares) ** 2).mean(axis=0))
    # Pairs of one place share their errors: the standard error is by runs of ten.
    runs = np.array([np.mean(falls[k : k + 10]) for k in range(0, len(falls), 10)])
    error = runs.std(ddof=1) / np.sqrt(len(runs)) if len(runs) > 2 else np.inf
    gain = float(runs.mean() / max(error, 1e-12))
    return (
        HeldOut(float(rms[0]), float(rms[1]), gain, len(falls)),
        np.concatenate(offs, axis=1),
        np.concatenate(distances),
    )


def _judged_steps(problem: JointProblem, held: BoolArray, first: JointFit, found: JointFit) -> HeldOut | None:
    """Motions by wheels against those of the camera, on held-out steps."""
    if not held.any():
        return None
    zero, start, end = np.zeros_like(found.values), *problem.data.steps.T
    sizes = []
    for values, fit in ((zero, first), (found.values, found)):
        T = fit.T_map_camera
        errors, sigmas = problem.step_errors(values, se3.invert(T[start]) @ T[end])
        sizes.append(((errors / sigmas)[held][:, :3] ** 2).mean(axis=1))
    fall = np.minimum(sizes[0], 16.0) - np.minimum(sizes[1], 16.0)
    error = fall.std(ddof=1) / np.sqrt(len(fall)) if len(fall) > 2 else np.inf
    before, after = (float(np.sqrt(np.minimum(size, 16.0).mean())) for size in sizes)
    return HeldOut(before, after, float(fall.mean() / max(error, 1e-12)), int(held.sum()))


def _refuse_if_apart(problem: JointProblem, first: JointFit) -> None:
    """Raise CalibrationError if views do not agree on surfaces: people, glass, or another drive's poses."""
    zero = np.zeros(len(problem.model))
    inside, total = 0, 0
    for pair in first.matches:
        off = np.abs(problem.off_m(pair, zero, first.T_map_camera) / problem.sigma_m(pair, zero))
        inside, total = inside + int((off < 4 * max(first.scale, 1.0)).sum()), total + len(off)
    if total == 0 or inside < _LEAST_INLIERS * total:
        share = 100 * inside / max(total, 1)
        raise CalibrationError(
            f"only {share:.0f} % of the surfaces that two views share agree",
            fix="drive where few people walk, past walls rather than glass and mirrors",
        )


def _refuse_if_moved(data: MapData, model: RobotModel) -> None:
    """Raise CalibrationError, with the time, if the floor says that the camera was moved on the robot."""
    if not model.has_mount:
        return
    mount = model.mount(np.zeros(len(model)))
    rows, stamps = list[FloatArray](), list[float]()
    for view, on in zip(data.views, data.floors, strict=True):
        if len(on) < _FEWEST_PAIRS:
            continue
        p = se3.apply(mount, view.points_m[on])
        A = np.column_stack([p[:, 0], p[:, 1], np.ones(len(p))]) / view.sigma_m[on, None]
        plane = np.linalg.lstsq(A, p[:, 2] / view.sigma_m[on])[0]
        rows.append(np.array([np.degrees(plane[0]), np.degrees(plane[1]), plane[2] + plane[0] * 2.0]))
        stamps.append(view.stamp_s)
    if len(rows) < _FEWEST_FLOORS:
        return
    order = np.argsort(stamps)
    tilts, stamps_s = np.array(rows)[order], np.array(stamps)[order]
    best, at = 0.0, 0
    for k in range(5, len(tilts) - 5):
        a, b = tilts[:k], tilts[k:]
        jump = np.abs(np.median(a, axis=0) - np.median(b, axis=0))
        spread = 1.4826 * np.median(
            np.abs(np.concatenate([a - np.median(a, axis=0), b - np.median(b, axis=0)])), axis=0
        )
        sure = jump / np.maximum(spread * np.sqrt(1 / len(a) + 1 / len(b)), 1e-9)
        size = jump / (_MOVED_DEG, _MOVED_DEG, _MOVED_M)
        score = float(np.where(sure > _MOVED_SIGMAS, size, 0.0).max())
        if score > best:
            best, at = score, k
    if best > 1.0:
        since_s = stamps_s[at] - stamps_s[0]
        raise CalibrationError(
            f"the floor jumps {since_s:.0f} s after the start: the camera was moved on the robot",
            fix="fix it, and drive again; of two mounts neither is right",
        )


# What a drive must have for each group of parameters.
_TO_DRIVE = {
    ("focal_length", "centre"): "turn on the spot, two to four metres from walls on all sides",
    ("depth_",): "pass the same walls from one metre and from four, and let wheels.csv lie beside the map",
    ("roll", "pitch", "height"): "let the camera see free floor",
    ("yaw", "x", "y"): "drive straight for some metres, and turn both ways on the spot",
    ("left_radius", "right_radius", "track_width", "slide"): "drive longer, straight and with turns both ways",
    ("delay",): "start, stop and turn now and then",
    ("gyro",): "turn both ways on the spot",
}
# Neither a value of the robot nor in its file.
NUISANCES = ("map_scale", "slide_s", "gyro_scale")


def not_shown(found: SelfCalibration) -> dict[str, tuple[str, ...]]:
    """Return the parameters that keep their value, by the drive that would show them."""
    kept = [name for name, taken in zip(found.model.names, found.taken, strict=True) if not taken]
    by_drive: dict[str, tuple[str, ...]] = {}
    for starts, drive in _TO_DRIVE.items():
        names = tuple(n for n in kept if n.startswith(starts) and n not in NUISANCES)
        if names:
            by_drive[drive] = names
    return by_drive
