"""Drives of `benchmarks.special_cases`: recordings, fields of obstacles, and goals in known maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.barn import Images, crossed
from benchmarks.barn_worlds import ROBOTS, read_field
from benchmarks.golden import command
from benchmarks.navigation_courses import KnownBuilding
from benchmarks.navigation_drives import Hardness, drives_from
from benchmarks.session_maps import kept_day
from benchmarks.session_starts import Building
from wheelsight import Localizer, Status, load_config, open_recording
from wheelsight.app.run.maps import open_known
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import FusedEstimate
from wheelsight.evaluation import ate
from wheelsight.navigation import NavigationSettings
from wheelsight.navigation.senses import WhereNow

_WRONG_M, _WRONG_CHI2 = 0.1, 14.2  # three standard deviations of a position, 99.73 %
_OFF_PLACE_M = 0.2
_LATE_FRAMES = 2
# Of `elevator`: when the robot stops, for how long, and the time at which the drive continues.
_STANDS_FROM_S, STANDS_S, _OTHER_PLACE_S = 8.0, 3.0, 16.0
# Of `silence` and `cover`: begin and durations. Of `wrong_depth`: its end where depth becomes right.
_SILENT_FROM_S, SILENT_S, _COVER_S = 8.0, 5.0, 1.2
_WRONG_UNTIL_S = 6.0


@dataclass(frozen=True)
class Figures:
    """Of one drive.

    Attributes:
        error_m: RMSE in the map from the true start, or after rigid alignment for a camera alone; driven time for
            goals and fields.
        end_m: of the last pose; NaN for a camera alone; way for goals and fields.
        posed, tracking, wrong: frames; goals, reached goals, contacts.
        total: frames, or goals.
        seconds: of the run.
    """

    error_m: float
    end_m: float
    posed: int
    tracking: int
    wrong: int
    total: int
    seconds: float


@dataclass(frozen=True)
class Drive:
    """A drive on disk, or one that is simulated while it is driven.

    Attributes:
        name: of it.
        family: see `Rule`.
        run: gives its figures.
        rules: names of the rules that are judged by it; empty for all of its family.
        leaves: names of rules that another drive of the same recording judges.
    """

    name: str
    family: str
    run: Callable[[], Figures]
    rules: tuple[str, ...] = ()
    leaves: tuple[str, ...] = ()


Change = Callable[[Iterator[Event], Trajectory], tuple[Iterator[Event], Trajectory]]


def late_color(events: Iterator[Event], truth: Trajectory) -> tuple[Iterator[Event], Trajectory]:
    """The events with the colour of two frames before."""

    def changed_events() -> Iterator[Event]:
        colors: list[Any] = []
        for event in events:
            if isinstance(event, RgbdFrame):
                colors.append(event.color)
                yield replace(event, color=colors[max(0, len(colors) - 1 - _LATE_FRAMES)])
            else:
                yield event

    return changed_events(), truth


def _during(events: Iterator[Event], seconds: float) -> Iterator[tuple[Event, bool]]:
    """Each event, and whether it is within some seconds from `_SILENT_FROM_S` on."""
    begin_s = None
    for event in events:
        begin_s = event.stamp_s if begin_s is None else begin_s
        yield event, _SILENT_FROM_S <= event.stamp_s - begin_s < _SILENT_FROM_S + seconds


def silence(events: Iterator[Event], truth: Trajectory) -> tuple[Iterator[Event], Trajectory]:
    """The events without any for a while, as from a bus that hangs."""
    return (event for event, is_silent in _during(events, SILENT_S) if not is_silent), truth


def cover(events: Iterator[Event], truth: Trajectory) -> tuple[Iterator[Event], Trajectory]:
    """The events with black images for a moment."""

    def changed_events() -> Iterator[Event]:
        for event, is_covered in _during(events, _COVER_S):
            if isinstance(event, RgbdFrame) and is_covered:
                yield replace(event, color=np.zeros_like(event.color), depth_m=np.zeros_like(event.depth_m))
            else:
                yield event

    return changed_events(), truth


def wrong_depth(
    events: Iterator[Event], truth: Trajectory, factor: float, until_s: float = np.inf
) -> tuple[Iterator[Event], Trajectory]:
    """The events with depth that is wrong by a factor, until some time after the begin."""

    def changed_events() -> Iterator[Event]:
        begin_s = None
        for event in events:
            begin_s = event.stamp_s if begin_s is None else begin_s
            if isinstance(event, RgbdFrame) and event.stamp_s - begin_s < until_s:
                yield replace(event, depth_m=event.depth_m * np.float32(factor))
            else:
                yield event

    return changed_events(), truth


def elevator(events: Iterator[Event], truth: Trajectory) -> tuple[Iterator[Event], Trajectory]:
    """Events and truth of a robot that stands before a known view, and then sees another place of the same drive."""
    all_events = list(events)
    begin_s = all_events[0].stamp_s
    from_s, to_s = begin_s + _STANDS_FROM_S, begin_s + _OTHER_PLACE_S
    shift_s = from_s + STANDS_S - to_s
    is_before, is_after = truth.stamps_s < from_s, truth.stamps_s >= to_s
    stamps_s = np.concatenate([truth.stamps_s[is_before], truth.stamps_s[is_after] + shift_s])
    T = np.concatenate([truth.T_frame_body[is_before], truth.T_frame_body[is_after]])
    return _standing(all_events, from_s, to_s, shift_s), Trajectory(stamps_s, T, body=truth.body)


def _standing(events: list[Event], from_s: float, to_s: float, shift_s: float) -> Iterator[Event]:
    before = [event for event in events if event.stamp_s < from_s]
    after = [event for event in events if event.stamp_s >= to_s]
    stood = next(event for event in reversed(before) if isinstance(event, WheelTicks))
    first = next(event for event in after if isinstance(event, WheelTicks))
    view = next(event for event in reversed(before) if isinstance(event, RgbdFrame))
    yield from before
    rng = np.random.default_rng(0)
    for event in events:
        stamp_s = event.stamp_s - events[0].stamp_s + from_s
        if stamp_s >= from_s + STANDS_S:
            break
        if isinstance(event, RgbdFrame):  # with noise, as equal images count as one
            color = np.clip(view.color + rng.integers(-2, 3, view.color.shape), 0, 255).astype(np.uint8)
            yield replace(view, stamp_s=stamp_s, color=color, index=event.index)
        elif isinstance(event, WheelTicks):
            yield replace(stood, stamp_s=stamp_s)
    for event in after:
        if isinstance(event, WheelTicks):
            left, right = event.left - first.left + stood.left, event.right - first.right + stood.right
            yield WheelTicks(event.stamp_s + shift_s, left, right)
        else:
            yield replace(event, stamp_s=event.stamp_s + shift_s)


def replay(
    path: Callable[[], Path], until_s: float, change: Change | None = None, *, is_alone: bool = False, **more: Any
) -> Figures:
    """Figures of a recording, joined with loops if it has wheels, else by the camera alone.

    Args:
        path: makes the recording if it does not exist, and returns its folder.
        until_s: seconds of it.
        change: applied to its events.
        is_alone: whether wheels are left out.
        more: settings by name, with `__` for a dot.
    """
    recording = open_recording(path())
    truth = recording.ground_truth
    assert truth is not None
    joined = bool(recording.wheel_count) and not is_alone
    chosen = {"odometry": "wheels,dense" if joined else "dense", "loops.source": "keyframes"}
    if not joined:
        chosen["loops.source"] = "none"
    chosen |= {name.replace("__", "."): value for name, value in more.items()}
    localizer = Localizer(recording.calibration, load_config(overrides=chosen), waits=True)
    begun_s, first_s, found, frames = time.process_time(), None, list[Estimate](), 0
    events = recording.events()
    if change is not None:
        events, truth = change(events, truth)
    for event in events:
        first_s = event.stamp_s if first_s is None else first_s
        if event.stamp_s - first_s > until_s:
            break
        estimate = localizer.process(event)
        if isinstance(event, RgbdFrame):
            frames += 1
            if estimate is not None and estimate.T_odom_body is not None:
                found.append(estimate)
    localizer.close()
    return _judged(found, frames, truth, time.process_time() - begun_s, joined=joined, is_simulated=is_alone)


def _judged(
    found: list[Estimate], frames: int, truth: Trajectory, seconds: float, *, joined: bool, is_simulated: bool
) -> Figures:
    tracking = [one.status is Status.TRACKING for one in found]
    stamps_s = np.array([one.stamp_s for one in found])
    if not joined:
        T = np.array([one.T_odom_body for one in found])
        error_m = ate(Trajectory(stamps_s, T, body=truth.body), truth).translation.rmse
        wrong = 0
        if is_simulated:  # poses from the true start
            is_inside = (stamps_s >= truth.stamps_s[0]) & (stamps_s <= truth.stamps_s[-1]) & np.array(tracking)
            T_true, T = truth.at(stamps_s[is_inside]), T[is_inside]
            off = (T[0] @ se3.invert(T_true[0]) @ T_true)[:, :3, 3] - T[:, :3, 3]
            covariances = [one.covariance for one, inside in zip(found, is_inside, strict=True) if inside]
            wrong = int(np.count_nonzero(_is_wrong(off, T, np.array(covariances))))
        return Figures(error_m, float("nan"), len(found), sum(tracking), wrong, frames, seconds)
    inside = (stamps_s >= truth.stamps_s[0]) & (stamps_s <= truth.stamps_s[-1])
    kept = [one for one, is_inside in zip(found, inside, strict=True) if is_inside]
    T_true = truth.at(stamps_s[inside])
    in_map, in_odom = (np.array([getattr(one, name) for one in kept]) for name in ("T_map_body", "T_filter_body"))
    off_map, off_odom = ((T[0] @ se3.invert(T_true[0]) @ T_true)[:, :3, 3] - T[:, :3, 3] for T in (in_map, in_odom))
    assert all(isinstance(one, FusedEstimate) for one in kept)
    is_tracking = np.array(tracking)[inside]
    wrong = is_tracking & _is_wrong(off_odom, in_odom, np.array([one.filter_covariance for one in kept]))
    off_m = np.linalg.norm(off_map, axis=1)
    error_m = float(np.sqrt(np.mean(off_m**2)))
    return Figures(error_m, float(off_m[-1]), len(kept), int(is_tracking.sum()), int(wrong.sum()), frames, seconds)


def _is_wrong(off: FloatArray, T: FloatArray, covariance: FloatArray) -> Any:
    """Whether positions (N, 3) are off by more than a pose (N, 4, 4) with its covariance (N, 6, 6) states."""
    P = se3.position_covariance(T, covariance)
    chi2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(P + 1e-6 * np.eye(3)), off)
    return (chi2 > _WRONG_CHI2) & (np.linalg.norm(off, axis=1) > _WRONG_M)


def field_figures(data: Path, number: int, seed: int) -> Figures:
    """Figures of a field of obstacles without a map (see `benchmarks.barn`)."""
    begun_s, by = time.process_time(), ROBOTS["wheelchair-kinect"]
    field = read_field(data / "barn", number, by.scale)
    one = crossed(field, by, seed, Images((320, 240)))
    taken_s = time.process_time() - begun_s
    return Figures(one.time_s, one.way_m, 1, int(one.is_success), len(one.contacts), 1, taken_s)


def goal_figures(known: Callable[[], KnownBuilding], number: int, seed: int) -> Figures:
    """Figures of a goal among people and things in a known map (see `benchmarks.navigation`)."""
    begun_s = time.process_time()
    goals = drives_from(known(), number, 1, seed, Hardness(people=4, things=3), lambda _: None)
    reached, touched = sum(one.has_arrived for one in goals), sum(len(one.contacts) for one in goals)
    times = sum(one.time_s for one in goals), sum(one.way_m for one in goals)
    return Figures(*times, len(goals), reached, touched, len(goals), time.process_time() - begun_s)


# Simulated by `wheelsight simulate`, 25 s at 10 frames a second.
SIMULATED = {
    "floor4-51": ("floor4", "--seed", "51"),
    "studio-52": ("studio", "--seed", "52", "--passers-by", "4"),
    "flat-53": ("flat", "--seed", "53", "--passers-by", "3"),
    "square-54": ("square", "--seed", "54"),
    "studio-55": ("studio", "--seed", "55", "--lift", "8:10"),
    "floor4-56": ("floor4", "--seed", "56", "--ice", "4,0,1.5", "--reverse"),
    "flat-57": ("flat", "--seed", "57", "--cover", "8:11"),
    "office_b-58": ("--plan", "maps/office_b.png", "--resolution", "0.05", "--seed", "58"),
    "studio-61": ("studio", "--seed", "61", "--passers-by", "4"),
    "flat-71": ("flat", "--seed", "71", "--cover", "8:12", "--dropout", "8:12"),
    "studio-65": ("studio", "--seed", "65", "--passers-by", "4", "--reverse"),
    "flat-63": ("flat", "--seed", "63", "--passers-by", "5", "--reverse"),
    "square-72": ("square", "--seed", "72", "--cover", "6:10", "--dropout", "6:10"),
    "floor4-62": ("floor4", "--seed", "62", "--passers-by", "6"),
    "square-64": ("square", "--seed", "64", "--passers-by", "4"),
    "flat-66": ("flat", "--seed", "66", "--ice", "2,0,2"),
    "office_b-67": ("--plan", "maps/office_b.png", "--resolution", "0.05", "--seed", "67", "--passers-by", "6"),
}
_HOW, _SHORT = ("--rate", "10"), ("--duration", "25")
# More crowds, for the rules that are about people; the first three are those of `SIMULATED`.
CROWDS = {f"{name}, crowd": SIMULATED[name] for name in ("studio-52", "studio-61", "studio-65")} | {
    f"studio-{seed}": ("studio", "--seed", str(seed), "--passers-by", "4", *(("--reverse",) if seed % 2 else ()))
    for seed in range(91, 99)
}
_OF_CROWDS = (
    "moving regions left out",
    "0.75 of the regions agree",
    "corrected keyframes (`_laid_again`)",
    "camera restarts in its map",
    "keyframes wait while undecided",
    "slip by time covers the wheels' pose",
)
# Whole routes, for keyframes that leave a small cache and are seen again.
LAPS = {
    "studio-81, laps": ("studio", "--seed", "81", "--laps", "4"),
    "studio-82, laps": ("studio", "--seed", "82", "--laps", "4", "--reverse"),
}
_SMALL_CACHE = 6
# Other days in the flat whose map is known.
DAYS = {
    f"flat-5, day {day}": ("flat", "--seed", "5", "--day", str(day), "--passers-by", "6", *more)
    for day, more in ((61, ()), (62, ("--reverse",)), (63, ()), (64, ()))
}
# Seconds of each real recording; a rule is not judged by the one on which it was found.
REAL = {"rgbd_dataset_freiburg1_desk": 20.0, "freiburg1_rpy_part": 9.0, "red_kitchen": 12.0}
_OF_CAMERA = (
    "DepthDelay",
    "two references",
    "moving regions left out",
    "misfit in the covariance",
    "information of 0.4 is confirmed",
    "half of the keypoints after 2 s",
    "limit on the speed of keypoints",
)
# Rules that a camera without wheels can show, and its drives.
_OF_CAMERA_ALONE = (
    "misfit in the covariance",
    "moving regions left out",
    "half of the keypoints after 2 s",
    "limit on the speed of keypoints",
)
_OF_COVERS = ("known again within 0.7 m after darkness",)
_CHANGED = ("floor4-51", "flat-53", "square-54", "office_b-58")
_ALONE = ("studio-52", "flat-53", "flat-57", "studio-61", "studio-65")
FIELDS_SEED, GOALS_SEED = 7, 11
# Those with most cylinders first.
_FIELDS = (120, 210, 150, 180, 30, 270, 240, 0, 60, 90, 122, 212)
FIELDS, GOALS = len(_FIELDS), 6


def simulated(path: Path, words: Sequence[str], data: Path) -> Path:
    """A simulated recording, which is written once."""
    if not path.exists():
        how = _HOW if "--laps" in words else (*_HOW, *_SHORT)
        command("simulate", *(str(data / one) if "/" in one else one for one in words), *how, "--out", str(path))
    return path


def drives_of(keep: Path, data: Path, fields: int, starts: int) -> list[Drive]:
    """All drives, those of recordings first."""
    found = []
    for name, until_s in REAL.items():
        if (data / "rgbd" / name).exists():
            rules = tuple(rule for rule in _OF_CAMERA if rule != "DepthDelay" or "desk" not in name)
            run = partial(replay, partial(Path, data / "rgbd" / name), until_s)
            found.append(Drive(name, "recordings", run, rules))
    for name, words in SIMULATED.items():
        found += _drives_in(name, partial(simulated, keep / "recordings" / name, words, data))
    found += _drives_in_crowds(keep, data)
    for name, words in LAPS.items():
        path = partial(simulated, keep / "recordings" / name, words, data)
        laps = partial(replay, path, np.inf, dense__kept_keyframes=_SMALL_CACHE)
        found.append(Drive(name, "recordings", laps, ("EvictedViews",)))
    flat = partial(known_building, "flat", keep / "maps")
    for name, words in DAYS.items():
        path = partial(simulated, keep / "recordings" / name.replace(", ", "-").replace(" ", ""), words, data)
        found.append(Drive(name, "places", partial(place_figures, flat, path)))
    for number in _FIELDS[:fields]:
        found.append(
            Drive(f"field {FIELDS_SEED}-{number}", "fields", partial(field_figures, data, number, FIELDS_SEED))
        )
    for name in ("flat", "studio"):
        known = partial(known_building, name, keep / "maps")
        for number in range(starts):
            run = partial(goal_figures, known, number, GOALS_SEED)
            found.append(Drive(f"{name}, goals {GOALS_SEED}-{number}", "goals", run))
    return found


def _drives_in_crowds(keep: Path, data: Path) -> list[Drive]:
    found = []
    for name, words in CROWDS.items():
        path = partial(simulated, keep / "recordings" / name.partition(",")[0], words, data)
        found.append(Drive(name, "recordings", partial(replay, path, np.inf), _OF_CROWDS))
        if ", crowd" not in name:
            alone = partial(replay, path, np.inf, is_alone=True)
            found.append(Drive(f"{name}, alone", "recordings", alone, _OF_CAMERA_ALONE))
    return found


def _drives_in(name: str, path: Callable[[], Path]) -> list[Drive]:
    """A simulated recording as it is, and changed for the rules that nothing else shows."""
    run = partial(replay, path, np.inf)
    found = [Drive(name, "recordings", run, leaves=_OF_CROWDS if f"{name}, crowd" in CROWDS else ())]
    if name in _CHANGED:
        of_depth = ("floor at a wrong distance",)
        then_right = partial(wrong_depth, factor=1.4, until_s=_WRONG_UNTIL_S)
        changes: list[tuple[str, Change, tuple[str, ...]]] = [
            ("colour late", late_color, ("ColorCheck",)),
            ("elevator", elevator, ("KidnapDetection beside standing wheels",)),
            ("silent", silence, ("UncertainRestart",)),
            ("cover of 1.2 s", cover, _OF_COVERS),
            ("depth of 0.2", partial(wrong_depth, factor=0.2), of_depth),
            ("depth of 1.4", partial(wrong_depth, factor=1.4), of_depth),
            ("depth of 1.4 at first", then_right, (*of_depth, "ReadmissionCheck (`SecondCheck`)")),
        ]
        for words, change, rules in changes:
            found.append(Drive(f"{name}, {words}", "recordings", partial(replay, path, np.inf, change), rules))
    if name in _ALONE:
        alone = partial(replay, path, np.inf, is_alone=True)
        found.append(Drive(f"{name}, alone", "recordings", alone, _OF_CAMERA_ALONE))
    return found


def place_figures(known: Callable[[], KnownBuilding], path: Callable[[], Path]) -> Figures:
    """Figures of the pose of navigation between estimates (`WhereNow`), on another day in a known map.

    Errors are those of poses at frames once a place was recognized; a wrong one is more than 0.2 m off.
    """
    building, recording = known(), open_recording(path())
    truth, wheels = recording.ground_truth, recording.calibration.wheels
    assert truth is not None
    assert wheels is not None
    chosen = {"odometry": "wheels,dense", "known_map.path": str(building.day.folder)}
    config = load_config(overrides=chosen)
    begun_s, off, tracking, frames = time.process_time(), list[tuple[float, bool]](), 0, 0
    opened = open_known(recording.calibration, config)
    assert opened is not None
    localizer = Localizer(recording.calibration, config, known=opened[0], waits=True)
    where = WhereNow(wheels)
    for event in recording.events():
        if isinstance(event, WheelTicks):
            where.roll(event)
        where.ask(event.stamp_s)
        estimate = localizer.process(event)
        where.processed(event.stamp_s)
        if estimate is None:
            continue
        where.answer(estimate)
        if not isinstance(event, RgbdFrame):
            continue
        frames += 1
        state, is_inside = where.state, truth.stamps_s[0] <= event.stamp_s <= truth.stamps_s[-1]
        is_tracking = estimate.status is Status.TRACKING
        tracking += is_tracking
        if state is not None and is_inside and localizer.recognised:
            true = building.map_pose(truth.at(np.array([event.stamp_s]))[0])
            off.append((float(np.hypot(*(state.pose - true)[:2])), is_tracking))
    localizer.close()
    opened[1].close()
    errors_m = np.array([one for one, _ in off] or [np.nan])
    wrong = sum(one > _OFF_PLACE_M and is_tracking for one, is_tracking in off)
    taken_s = time.process_time() - begun_s
    rmse_m = float(np.sqrt(np.mean(errors_m**2)))
    return Figures(rmse_m, float(errors_m.max()), len(off), tracking, wrong, frames, taken_s)


def known_building(name: str, folder: Path) -> KnownBuilding:
    """The map of the first day of a world, made once."""
    building = Building(name, name, None)
    return KnownBuilding(building, kept_day(building, folder, {}, 10.0), NavigationSettings())
