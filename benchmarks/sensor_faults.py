"""`python -m benchmarks.sensor_faults`: a sensor fails in the middle of a drive; what does the robot say of its pose?

Each fault begins at 15 s of a simulated drive and stays, or ends after some seconds. The worst errors are distances in
the plane from the true pose, nothing aligned: of the pose in `odom`, which does not jump, and of the pose in `map`,
which takes the correction of the past. A frame is sure and wrong if its pose in `odom` or `map` is `tracking`, not
doubtful, over 0.5 m off, and outside 3σ. The limit of the error is 1.5 times that of the best single sensor, plus
0.15 m.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.clock_rows import drive_of
from benchmarks.table import Sheet, shown
from wheelsight import Localizer, RgbdFrame, Status, WheelTicks, load_config
from wheelsight.core.estimates import FusedEstimate
from wheelsight.core.files import write_text
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, YawRate
from wheelsight.io.recordings import Recording
from wheelsight_sim import SimulationSettings

BEGIN_S, FAR_M, TIMES, PLUS_M = 15.0, 0.5, 1.5, 0.15
SOON_S, SOON_M = 3.0, 1.0
_LAPS = 8  # of a small world, which is driven through in less than the duration
_MADE = (
    f"A drive is what `wheelsight simulate WORLD --rate 10 --duration 45 --laps {_LAPS} --size 320x240 --seed N` "
    "writes. It is localized by `wheels,dense`. The worst error is the largest distance in the plane from the true "
    f"pose of any frame of each drive, nothing aligned. The limit is {TIMES:g} times the worst error of the best "
    f"single sensor, plus {PLUS_M:g} m. Others are sound sensors that were named. A frame is sure and "
    f"wrong if it is `tracking`, not doubtful, over {FAR_M:g} m "
    "off in `odom` or `map`, and outside 3σ."
)
_COVERED_S = 30.0, 36.0  # once a wheel is used with its new scale
_COMPILED_S = 5.0  # after which kernels are compiled
_GYRO_HZ, _GYRO_BIAS_RAD_S, _GYRO_NOISE_RAD_S = 100, 0.01, 0.003
Change = Callable[[Event, bool], Event]
"""Returns an event of a drive, changed while the fault is there."""


@dataclass(frozen=True)
class SensorFaultCase:
    """A fault.

    Attributes:
        name: of the row.
        make: returns the change of events, for one drive.
        named: words of the warning that names the sensor; none for no fault.
        has_gyro: whether the robot has a gyroscope.
        begin_s, end_s: when.
    """

    name: str
    make: Callable[[], Change]
    named: str = ""
    has_gyro: bool = False
    begin_s: float = BEGIN_S
    end_s: float = math.inf


def _wheels(left: float, right: float) -> Callable[[], Change]:
    """A change that scales the ticks of both wheels."""

    def make() -> Change:
        last: list[WheelTicks] = []
        sums = np.zeros(2)

        def change(event: Event, is_faulty: bool) -> Event:
            if not isinstance(event, WheelTicks):
                return event
            by = (left, right) if is_faulty else (1, 1)
            if not last:
                sums[:] = event.left, event.right
            else:
                sums[:] += (event.left - last[0].left) * by[0], (event.right - last[0].right) * by[1]
            last[:] = [event]
            return replace(event, left=round(sums[0]), right=round(sums[1]))

        return change

    return make


def _wheel_then_cover(left: float) -> Callable[[], Change]:
    """A change of the left wheel, and black images for some seconds later."""

    def make() -> Change:
        of_wheels, first = _wheels(left, 1)(), list[float]()

        def change(event: Event, is_faulty: bool) -> Event:
            first[:] = first or [event.stamp_s]
            event = of_wheels(event, is_faulty)
            if isinstance(event, RgbdFrame) and _COVERED_S[0] <= event.stamp_s - first[0] < _COVERED_S[1]:
                return replace(event, color=np.zeros_like(event.color), depth_m=np.zeros_like(event.depth_m))
            return event

        return change

    return make


def _images(change: Callable[[RgbdFrame], RgbdFrame]) -> Callable[[], Change]:
    return lambda: lambda event, is_faulty: change(event) if is_faulty and isinstance(event, RgbdFrame) else event


def _mirrored(frame: RgbdFrame) -> RgbdFrame:
    return replace(
        frame, color=np.ascontiguousarray(frame.color[:, ::-1]), depth_m=np.ascontiguousarray(frame.depth_m[:, ::-1])
    )


def _passing(share: float, speed_px_s: float, depth_m: float) -> Callable[[], Change]:
    """A textured plane that fills a share of the view and passes."""

    def make() -> Change:
        rng = np.random.default_rng(0)
        texture = cv2.resize(
            rng.integers(0, 255, (60, 400, 3), dtype=np.uint8), (2400, 720), interpolation=cv2.INTER_CUBIC
        )

        first: list[float] = []

        def change(frame: RgbdFrame) -> RgbdFrame:
            first[:] = first or [frame.stamp_s]
            height, width = frame.depth_m.shape
            wide = int(share * width)
            x, begin = int(speed_px_s * (frame.stamp_s - first[0])) % (2400 - wide), (width - wide) // 2
            color, depth = frame.color.copy(), frame.depth_m.copy()
            color[:, begin : begin + wide] = texture[:height, x : x + wide]
            depth[:, begin : begin + wide] = depth_m + 0.006 * rng.standard_normal((height, wide))
            return replace(frame, color=color, depth_m=depth)

        return _images(change)()

    return make


def _frozen() -> Change:
    first: list[RgbdFrame] = []

    def change(frame: RgbdFrame) -> RgbdFrame:
        first[:] = first or [frame]
        return replace(frame, color=first[0].color, depth_m=first[0].depth_m)

    return _images(change)()


def _gyro(factor: float) -> Callable[[], Change]:
    def change(event: Event, is_faulty: bool) -> Event:
        if is_faulty and isinstance(event, YawRate):
            return replace(event, yaw_rate_rad_s=event.yaw_rate_rad_s * factor)
        return event

    return lambda: change


def _scaled_depth(factor: float) -> Callable[[], Change]:
    return _images(lambda frame: replace(frame, depth_m=(frame.depth_m * np.float32(factor)).astype(np.float32)))


CASES = (
    SensorFaultCase("clean", lambda: lambda event, _: event),
    SensorFaultCase("clean, gyroscope", lambda: lambda event, _: event, has_gyro=True),
    SensorFaultCase("left encoder reversed", _wheels(-1, 1), "left wheel"),
    SensorFaultCase("left encoder dies", _wheels(0, 1), "left wheel"),
    SensorFaultCase("right encoder dies", _wheels(1, 0), "right wheel"),
    SensorFaultCase("both encoders die", _wheels(0, 0), "both wheels"),
    SensorFaultCase("left wheel counts 10 % more", _wheels(1.1, 1), "left wheel"),
    SensorFaultCase("left wheel 10 % more, covered from 30 to 36 s", _wheel_then_cover(1.1), "left wheel"),
    SensorFaultCase("right wheel counts 15 % less", _wheels(1, 0.85), "right wheel"),
    SensorFaultCase("images mirrored for 10 s", _images(_mirrored), "camera", end_s=25.0),
    SensorFaultCase("a plane passes, 90 % of the view, 7 s", _passing(0.9, 150, 1.3), "camera", end_s=22.0),
    SensorFaultCase("a plane passes, all of the view, 7 s", _passing(1.0, 150, 1.3), "camera", end_s=22.0),
    SensorFaultCase("images frozen", _frozen, "camera"),
    SensorFaultCase("depth 20 % less", _scaled_depth(0.8), "camera"),
    SensorFaultCase("gyroscope's sign swaps", _gyro(-1), "gyroscope", has_gyro=True),
    SensorFaultCase("gyroscope dies", _gyro(0), "gyroscope", has_gyro=True),
    SensorFaultCase("left encoder dies, gyroscope", _wheels(0, 1), "left wheel", has_gyro=True),
    SensorFaultCase("images mirrored for 10 s, gyroscope", _images(_mirrored), "camera", has_gyro=True, end_s=25.0),
)


@dataclass(frozen=True)
class FaultFigures:
    """Of a drive with a fault.

    Attributes:
        case, world, seed: which.
        odom_m, map_m: worst errors in both frames.
        best_m: worst error of the best single sensor.
        frames: with a pose.
        sure_wrong: number of frames that are sure and wrong.
        doubtful: number of doubtful frames.
        found_s, found_m: time and way from the fault to the first warning that names the sensor; nan without one.
        warnings: all of them.
        slowest_ms: longest time for one event.
        found_m: see `found_s`.
        nees: mean of dᵀ C⁻¹ d / 3 of x, y and yaw in odom; 1 is right, 0.5 to 2 is asked for.
    """

    case: str
    world: str
    seed: int
    odom_m: float
    map_m: float
    best_m: float
    frames: int
    sure_wrong: int
    doubtful: int
    found_s: float
    warnings: tuple[str, ...]
    slowest_ms: float
    found_m: float = math.nan
    nees: float = math.nan

    @property
    def limit_m(self) -> float:
        """Of the worst error."""
        return TIMES * self.best_m + PLUS_M


def events_of(recording: Recording, case: SensorFaultCase) -> Iterator[Event]:
    """Return the events of a drive with a fault; the gyroscope is made from the truth."""
    events = list(recording.events())
    begin_s, truth = events[0].stamp_s, recording.ground_truth
    assert truth is not None
    if case.has_gyro:
        rng, stamps_s = np.random.default_rng(5), np.arange(begin_s, events[-1].stamp_s, 1 / _GYRO_HZ)
        yaw = np.unwrap(np.arctan2(truth.T_frame_body[:, 1, 0], truth.T_frame_body[:, 0, 0]))
        rates = np.gradient(np.interp(stamps_s, truth.stamps_s, yaw), stamps_s) + _GYRO_BIAS_RAD_S
        rates += _GYRO_NOISE_RAD_S * rng.standard_normal(len(rates))
        events += [YawRate(float(stamp_s), float(rate)) for stamp_s, rate in zip(stamps_s, rates, strict=True)]
        events.sort(key=lambda event: event.stamp_s)
    change = case.make()
    for event in events:
        yield change(event, case.begin_s <= event.stamp_s - begin_s < case.end_s)


@dataclass(slots=True)
class _Run:
    """What a localizer says along a drive, against the truth; see `FaultFigures`."""

    odom_m: float = 0.0
    map_m: float = 0.0
    frames: int = 0
    sure_wrong: int = 0
    doubtful: int = 0
    found_s: float = math.nan
    found_m: float = math.nan
    warnings: tuple[str, ...] = ()
    slowest_s: float = 0.0
    nees: list[float] = field(default_factory=list)


def drive(recording: Recording, case: SensorFaultCase, odometry: str, **overrides: str) -> _Run:
    """Localize a drive with a fault by some sensors."""
    run, truth = _Run(), recording.ground_truth
    assert truth is not None
    T_world_odom: FloatArray | None = None
    config = load_config(overrides={"odometry": odometry, **overrides})
    with Localizer(recording.calibration, config) as localizer:
        begin_s: float | None = None
        for event in events_of(recording, case):
            begin_s = event.stamp_s if begin_s is None else begin_s
            started_s = time.perf_counter()
            answer = localizer.process(event)
            if event.stamp_s - begin_s > _COMPILED_S:
                run.slowest_s = max(run.slowest_s, time.perf_counter() - started_s)
            named = [one for one in localizer.warnings if case.named and f"{case.named} w" in one and "left out" in one]
            if math.isnan(run.found_s) and named:
                run.found_s = event.stamp_s - begin_s - case.begin_s
                since_s = truth.stamps_s - begin_s - case.begin_s
                run.found_m = truth.select((since_s >= 0) & (since_s <= run.found_s)).length_m
            is_judged = isinstance(event, RgbdFrame) or odometry == "wheels"
            if answer is None or answer.T_odom_body is None or not is_judged:
                continue
            T, T_true = answer.T_odom_body, truth.at([np.clip(answer.stamp_s, *truth.stamps_s[[0, -1]])])[0]
            if answer.body == "camera":
                assert recording.calibration.T_base_camera is not None
                T = T @ se3.invert(recording.calibration.T_base_camera)
            if T_world_odom is None:
                T_world_odom = T_true @ se3.invert(T)
            odom_m, map_m = (
                float(np.linalg.norm((T_world_odom @ pose @ T - T_true)[:2, 3]))
                for pose in (np.eye(4), answer.T_map_odom)
            )
            run.frames += 1
            run.odom_m, run.map_m = max(run.odom_m, odom_m), max(run.map_m, map_m)
            is_doubtful = isinstance(answer, FusedEstimate) and answer.doubtful
            run.doubtful += is_doubtful
            if isinstance(answer, FusedEstimate) and answer.covariance is not None and run.frames > 1:
                run.nees.append(planar_nees(se3.invert(T_world_odom) @ T_true, T, answer.covariance))
            if answer.status is Status.TRACKING and not is_doubtful:
                assert answer.covariance is not None
                C_map = answer.covariance if answer.covariance_map is None else answer.covariance_map
                run.sure_wrong += _is_wrong(odom_m, answer.T_odom_body, answer.covariance) or _is_wrong(
                    map_m, answer.T_map_odom @ answer.T_odom_body, C_map
                )
        run.warnings = tuple(localizer.warnings)
    return run


def _is_wrong(error_m: float, T: FloatArray, covariance: FloatArray) -> bool:
    """Whether a pose (4, 4) with a covariance (6, 6) is far from the truth, and outside 3σ."""
    if error_m <= FAR_M:
        return False
    C = se3.position_covariance(T, covariance)[:2, :2]
    return error_m > 3 * math.sqrt(max(np.linalg.eigvalsh(C)[-1], 0.0))


def planar_nees(T_true: FloatArray, T: FloatArray, covariance: FloatArray) -> float:
    """Return dᵀ C⁻¹ d / 3 of x, y and yaw in the axes of the body, for a pose (4, 4) and a covariance (6, 6)."""
    to_body = se3.adjoint(se3.invert(T))
    planar = np.ix_([0, 1, 5], [0, 1, 5])
    off = se3.log(se3.invert(T) @ T_true)[[0, 1, 5]]
    return float(off @ np.linalg.solve((to_body @ covariance @ to_body.T)[planar], off)) / 3


def measure_case(
    recording: Recording, case: SensorFaultCase, world: str, seed: int, camera_m: float, **overrides: str
) -> FaultFigures:
    """Measure a fault on a drive; `camera_m` is the worst error of the camera alone without a fault."""
    wheels = drive(recording, case, "wheels").odom_m
    best_m = wheels if "camera" in case.named else min(camera_m, wheels)
    run = drive(recording, case, "wheels,dense", **overrides)
    return FaultFigures(
        case.name,
        world,
        seed,
        run.odom_m,
        run.map_m,
        best_m,
        run.frames,
        run.sure_wrong,
        run.doubtful,
        run.found_s,
        run.warnings,
        1000 * run.slowest_s,
        run.found_m,
        float(np.mean(run.nees)) if run.nees else math.nan,
    )


def faults_sheet(figures: Sequence[FaultFigures], title: str) -> Sheet:
    """A line a fault: the worst over all drives, and how many of them are within the limits."""
    worlds, seeds = len({one.world for one in figures}), len({one.seed for one in figures})
    rows = []
    for name in dict.fromkeys(one.case for one in figures):
        case = next(one for one in CASES if one.name == name)
        of_case = [one for one in figures if one.case == name]
        worst = [one.odom_m for one in of_case], [one.map_m for one in of_case]
        found = [(one.found_s, one.found_m) for one in of_case if not math.isnan(one.found_s)]
        soon = sum(found_s <= SOON_S or found_m <= SOON_M for found_s, found_m in found)
        alarms = sum(bool(one.warnings) for one in of_case)
        others = sum("left out" in text and case.named not in text for one in of_case for text in one.warnings)
        within = [sum(error <= one.limit_m for error, one in zip(errors, of_case, strict=True)) for errors in worst]
        rows.append(
            (
                name,
                *(" ".join(f"{error:.2f}" for error in errors) for errors in worst),
                f"{within[0]}, {within[1]} of {len(of_case)}",
                str(sum(one.sure_wrong for one in of_case)),
                f"{100 * sum(one.doubtful for one in of_case) / max(sum(one.frames for one in of_case), 1):.0f} %",
                f"{len(found)} of {len(of_case)}" + (f", {others} others" if others else "")
                if case.named
                else f"{alarms} alarms",
                str(soon) if case.named else "—",
                f"{np.median(found, axis=0)[0]:.1f} ({max(found)[0]:.1f})" if found else "—",
                " ".join(f"{one.nees:.2g}" for one in of_case),
                f"{max(one.slowest_ms for one in of_case):.0f}",
            )
        )
    head = (
        "fault",
        "worst m, odom",
        "worst m, map",
        "within the limit",
        "sure and wrong",
        "doubtful",
        "named",
        f"in {SOON_S:g} s or {SOON_M:g} m",
        "after s (worst)",
        "NEES / 3",
        "slowest event ms",
    )
    return Sheet(f"{title}: {worlds} worlds, {seeds} seeds", head, tuple(rows))


def main() -> None:
    """Measure, print, and write what is asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensor_faults", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--worlds", nargs="+", default=["flat"], help="simulated buildings (flat)")
    parser.add_argument("--seeds", nargs="+", type=int, default=[3, 11], help="of the drives (3 11)")
    parser.add_argument("--cases", nargs="+", default=[], metavar="WORDS", help="parts of names of faults; else all")
    parser.add_argument("--seconds", type=float, default=45.0, help="duration of a drive (45)")
    parser.add_argument("--realism", default="ideal", help="of the sensors (ideal)")
    parser.add_argument("--loops", action="store_true", help="also with a map and loops")
    parser.add_argument("--images", type=Path, metavar="DIR", help="keeps drives for next time")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keeps results; those kept are not measured again")
    parser.add_argument("--out", type=Path, help="Markdown file for the table")
    arguments = parser.parse_args()
    cases = [one for one in CASES if not arguments.cases or any(word in one.name for word in arguments.cases)]
    settings = SimulationSettings(
        "flat", size=(320, 240), rate_hz=10.0, duration_s=arguments.seconds, realism=arguments.realism, laps=_LAPS
    )
    hows: dict[str, dict[str, str]] = {"": {}}
    if arguments.loops:
        hows[" with loops"] = {"map": "surfels", "loops.source": "keyframes"}
    figures: dict[str, list[FaultFigures]] = {how: [] for how in hows}
    with TemporaryDirectory() as made:
        for seed in arguments.seeds:
            for world in arguments.worlds:
                images = (arguments.images or Path(made)) / arguments.realism
                recording = drive_of(seed, images, replace(settings, world=world))
                camera_m: float | None = None
                for how, case in product(hows, cases):
                    name = re.sub("[^a-z0-9]+", "-", f"{world} {arguments.realism} {seed} {case.name}{how}".lower())
                    kept = None if arguments.keep is None else arguments.keep / f"{name}.json"
                    if kept is not None and kept.exists():
                        record = json.loads(kept.read_text())
                        figures[how].append(FaultFigures(**{**record, "warnings": tuple(record["warnings"])}))
                        continue
                    if camera_m is None:
                        camera_m = drive(recording, CASES[0], "dense").odom_m
                    one = measure_case(recording, case, world, seed, camera_m, **hows[how])
                    figures[how].append(one)
                    if kept is not None:
                        kept.parent.mkdir(parents=True, exist_ok=True)
                        write_text(kept, json.dumps(asdict(one), indent=1))
                    print(one, file=sys.stderr, flush=True)
    titles = {"": "Faults in mid-drive", " with loops": "The same with a map and loops"}
    sheets = [faults_sheet(of, titles[how]) for how, of in figures.items()]
    console = Console(width=None if sys.stdout.isatty() else 200)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_text(arguments.out, "\n".join([*_page_head(arguments), *(sheet.to_markdown() for sheet in sheets)]))


def _page_head(asked: argparse.Namespace) -> list[str]:
    """Return the lines before the tables."""
    system = machine.description()
    words = ["python -m benchmarks.sensor_faults --worlds", *asked.worlds, "--seeds", *map(str, asked.seeds)]
    words += ["--loops"] if asked.loops else []
    words += ["--cases", *map(repr, asked.cases)] if asked.cases else []
    command = " ".join([*words, f"--realism {asked.realism} --out {shown(asked.out)}"])
    lines = [f"- {name}: {system[name]}" for name in ("Date", "System", "Versions")]
    return ["# Faults of sensors in mid-drive", "", f"Written by `{command}`.", "", *lines, "", _MADE, ""]


if __name__ == "__main__":
    main()
