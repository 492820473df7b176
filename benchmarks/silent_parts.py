"""`python -m benchmarks.silent_parts`: a part of the robot's program hangs or dies at 0.5 m/s; when do the motors stop?

The robot is a wheel controller behind a pseudo-terminal, with motors that answer after 0.1 s and the firmware's
watchdog of 0.25 s. Its program is a process of its own, as `wheelsight drive --robot` runs: the serial link, the
navigator of a known hall with MPPI, a planner in a thread, a localization in another process (by wheels), and a camera
whose frames (15 a second) come from a third process. The parts are suspended (SIGSTOP) or killed (SIGKILL) at a random
moment of a straight drive; the planner, a thread, hangs or raises in the plan that a box in the way makes necessary.
For the page the same navigator drives in the session of `wheelsight serve`: its door, a process, is suspended or
killed, and its event loop, a thread, hangs or ends.

"Motors at zero" is the time from the signal until the controller has duties of zero for good, "way" what the wheels
roll until then. "Moved later" counts the runs in which the motors turned again: the program is watched for 5 s more.
A part that was suspended is resumed 5 s after it, and watched for 3 s more.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.sharedctypes import SynchronizedArray
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import machine
from benchmarks.navigation_page import write_section
from benchmarks.table import Sheet, targets_sheet
from benchmarks.targets import Target
from wheelsight.app.page import Access, Driven, Session
from wheelsight.app.page.server import PageServer, page_app
from wheelsight.app.page.session import GoToPose
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import DeviceError, WheelsightError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.robots import Robot
from wheelsight.estimation import Localizer, LocalizerApart, LocalizerBeside
from wheelsight.io.devices import LinkRobot, LinkStatus, WheelLink
from wheelsight.io.devices.camera_driver import DeviceImages, OpenedDevice
from wheelsight.io.devices.live_camera import StreamingCamera
from wheelsight.io.devices.simulated_controller import SimulatedController
from wheelsight.mapping import CellKind, OccupancyGrid
from wheelsight.navigation import Feedback, KnownFloor, Navigator, PlanningResult, Transition, WorkerBeside

WITHIN_S, WITHIN_M, SPEED_M_S = 0.6, 0.3, 0.5
_TITLE = "Parts that hang or die"
_WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
_CAMERA = PinholeCamera(160, 120, 131.0, 130.0, 80.0, 60.0)
_MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
_CALIBRATION = Calibration.registered_camera(_CAMERA, wheels=_WHEELS, T_base_camera=_MOUNT, source="benchmark")
_LOW, _HIGH = np.array([-2.0, -2.0, 0.0]), np.array([14.0, 2.0, 2.6])
_GOAL = (11.0, 0.0)
_FRAME_S, _LAG_S, _FULL_M_S = 1 / 15, 0.1, 2.6
_RESUMED_S, _WATCHED_S, _START_S, _STARTS = 5.0, 3.0, 120.0, 3
# A box fills the hall's middle so far ahead of the base: the plan leads through it no more.
_BOX_M, _BOX_HALF_M = 3.0, 0.5
PARTS = ("localization", "camera", "planner", "program", "door", "page")
# They are threads: a signal to the program makes them hang or end.
_THREADS = ("planner", "page")
_OF_PAGE = ("door", "page")
OnTransition = Callable[[Transition], None]
FAULTS = ("hangs", "dies")


class NotDrivenError(Exception):
    """The program ended, or stood for `_START_S`, before it drove at full speed; says why."""


class Motors:
    """Two motors that follow their duties with a lag: pulses of both wheels in so many seconds."""

    def __init__(self) -> None:
        self.speeds_m_s, self._rest = np.zeros(2), np.zeros(2)

    def __call__(self, duties: tuple[int, int], seconds: float) -> tuple[int, int]:
        """Go on for so long."""
        goal = _FULL_M_S * np.array(duties) / 1000
        self.speeds_m_s += (1 - math.exp(-seconds / _LAG_S)) * (goal - self.speeds_m_s)
        pulses = self.speeds_m_s * seconds / _WHEELS.left_m_per_tick + self._rest
        left, right = np.floor(pulses).astype(int).tolist()
        self._rest = pulses - (left, right)
        return left, right


@contextmanager
def localizer_by_wheels() -> Iterator[Localizer]:
    """What answers in the process of the localization."""
    with closing(Localizer(_CALIBRATION, load_config(overrides={"odometry": "wheels"}))) as localizer:
        yield localizer


def depth_of_hall(pose: FloatArray, box_x_m: float) -> Float32Array:
    """(H, W) depth, metres, of the hall from inside, where the base is at (3,); a box across it begins at `box_x_m`."""
    T = se3.from_plane(*pose) @ _MOUNT
    rays, origin = _CAMERA.rays() @ T[:3, :3].T, T[:3, 3]
    rays = np.where(rays == 0, 1e-9, rays)
    depth_m = np.where(rays > 0, (_HIGH - origin) / rays, (_LOW - origin) / rays).min(axis=-1)
    to_box_m = np.where(rays[..., 0] > 0, (box_x_m - origin[0]) / rays[..., 0], np.inf)
    at_box = origin + rays * np.nan_to_num(to_box_m, posinf=1e6)[..., None]
    hits = (to_box_m > 0) & (to_box_m < depth_m) & (np.abs(at_box[..., 1]) < _BOX_HALF_M) & (at_box[..., 2] < 1.5)
    return np.where(hits, to_box_m, depth_m).clip(0, 8.0).astype(np.float32)


def send_frames(connection: Connection, where: SynchronizedArray[float]) -> None:
    """What the camera's process does: draw what the robot sees, 15 times a second."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    number = 0
    with suppress(OSError):
        while True:
            stamp_s = time.monotonic()
            *pose, box_x_m = where[:]
            connection.send((number, stamp_s, depth_of_hall(np.array(pose), box_x_m)))
            number += 1
            time.sleep(max(_FRAME_S - (time.monotonic() - stamp_s), 0.0))


class ProcessDriver:
    """A camera driver whose frames come from a process of its own.

    Args:
        where: x, y, yaw of the robot, and where a box begins, for that process.
    """

    def __init__(self, where: SynchronizedArray[float]) -> None:
        self._where = where
        self._connection: Connection | None = None

    def open(self) -> OpenedDevice:
        """As `CameraDriver`; a process that died is a camera that is gone for good."""
        if self._connection is not None:
            raise DeviceError("the camera's process has died")
        context = get_context("spawn")
        self._connection, theirs = context.Pipe()
        self.process = context.Process(target=send_frames, args=(theirs, self._where), daemon=True)
        self.process.start()
        theirs.close()
        self._connection.poll(_START_S)  # a camera that sends nothing at its begin is opened again
        return OpenedDevice("a drawn hall", _CALIBRATION)

    def read(self, timeout_s: float) -> DeviceImages | None:
        """As `CameraDriver`."""
        assert self._connection is not None
        if not self._connection.poll(timeout_s):
            return None
        try:
            number, stamp_s, depth_m = self._connection.recv()
        except (EOFError, OSError):
            raise DeviceError("the camera's process has died") from None
        color = np.zeros((*depth_m.shape, 3), np.uint8)
        return DeviceImages(color, depth_m, stamp_s, stamp_s, number)

    def close(self) -> None:
        """As `CameraDriver`; the process ends with the program."""


class FaultyPlanner(WorkerBeside[PlanningResult]):
    """Hangs or raises in the next plan, once it has a fault; says so on standard output."""

    fault = ""

    def ask(self, work: Any, now_s: float) -> None:
        """As `Worker`."""
        fault = self.fault
        if not fault:
            super().ask(work, now_s)
            return
        say("fault")

        def failing() -> PlanningResult:
            if fault == "dies":
                raise WheelsightError("the planner failed")
            threading.Event().wait(60)
            raise AssertionError

        super().ask(failing, now_s)


def say(*words: object) -> None:
    """A line for the benchmark, with the time."""
    print(f"{time.monotonic():.4f}", *words, flush=True)


@contextmanager
def parts_of(port: str) -> Iterator[tuple[LinkRobot, Callable[[Robot, OnTransition], Navigator]]]:
    """The robot, and a function that makes its navigator; says "ready" once its processes run.

    A fault of the planner comes by signal: it is in the next plan, which a box in the way makes necessary.
    """
    config = load_config(
        overrides={"navigation.limits.forward_m_s": SPEED_M_S, "navigation.monitor.blind_m_s": SPEED_M_S}
    )
    where = get_context("spawn").Array("d", [0.0, 0.0, 0.0, 1e3])
    driver, planner = ProcessDriver(where), FaultyPlanner("planning")

    def fail_plans(number: int, _: object) -> None:
        planner.fault = "hangs" if number == signal.SIGUSR1 else "dies"
        where[3] = where[0] + _BOX_M

    signal.signal(signal.SIGUSR1, fail_plans)
    signal.signal(signal.SIGUSR2, fail_plans)
    apart = LocalizerApart(localizer_by_wheels)
    link, camera = WheelLink(port), StreamingCamera(driver)
    with (
        LinkRobot(link, _CALIBRATION, config.navigation.limits, frames=camera) as robot,
        closing(LocalizerBeside(apart)) as localization,
    ):
        while link.status is not LinkStatus.CONNECTED:
            time.sleep(0.05)
        children = {process.name: process.pid for process in get_context("spawn").active_children()}

        def navigator_of(driven: Robot, on_transition: OnTransition) -> Navigator:
            made = Navigator(
                driven,
                localization,
                KnownFloor(hall()),
                config.navigation,
                planning=planner,
                trusts_floor=True,
                on_transition=on_transition,
            )
            step = made.step

            def shown() -> Feedback:
                feedback = step()
                if feedback.pose is not None:
                    where[:3] = feedback.pose.tolist()
                return feedback

            made.step = shown  # type: ignore[method-assign]
            return made

        say("ready", children["wheelsight-localizer"], driver.process.pid)
        yield robot, navigator_of


def program(port: str) -> None:
    """The robot's program: drive down the hall, and say how it ends."""
    with parts_of(port) as (robot, navigator_of):
        navigator = navigator_of(robot, lambda transition: say("state", transition))
        navigator.go_to_pose(_GOAL)
        try:
            while not navigator.is_task_complete():
                navigator.step()
            result = navigator.result
            say("end", "arrived" if result else f"{result.reason}: {result.detail}" if result is not None else "")
            until_s = time.monotonic() + _RESUMED_S + _WATCHED_S
            while time.monotonic() < until_s:
                navigator.step()
        except Exception as error:
            robot.stop()
            say("end", f"{type(error).__name__}: {error}")
            while True:
                time.sleep(1.0)


class HallMaps:
    """The hall, the only map of a session, in which nothing has a name."""

    first = "hall"

    def __init__(self, navigator_of: Callable[[Robot, OnTransition], Navigator]) -> None:
        self._navigator_of = navigator_of

    def names(self) -> tuple[str, ...]:
        """As `Maps`."""
        return (self.first,)

    def last_saved(self) -> str:
        """As `Maps`."""
        return self.first

    @contextmanager
    def opened(self, name: str, robot: Robot, pose: FloatArray | None, on_transition: OnTransition) -> Iterator[Driven]:
        """As `Maps`."""
        yield Driven(self._navigator_of(robot, on_transition), self, is_new=False)

    def where(self) -> dict[str, FloatArray]:
        """As `Places`."""
        return {}

    def name(self, name: str, pose: FloatArray) -> None:
        """As `Places`."""


def served_program(port: str) -> None:
    """The robot's program with its page, as `wheelsight serve --robot` runs it; a fault of the page comes by signal."""
    settings = load_config().page
    how: dict[str, Any] = {"paces": False, "on_problem": partial(say, "end")}
    with (
        parts_of(port) as (robot, navigator_of),
        Session(robot, HallMaps(navigator_of), settings, **how) as session,
    ):
        app = page_app(
            session, settings, Access(is_loopback=True, token=""), lambda line: say("refused", line.partition("\n")[0])
        )
        with PageServer(app, "127.0.0.1", 0, settings) as server:

            def fail_page(number: int, _: object) -> None:
                assert server.loop is not None
                hang = partial(time.sleep, 60.0)
                server.loop.call_soon_threadsafe(hang if number == signal.SIGUSR1 else server.loop.stop)

            signal.signal(signal.SIGUSR1, fail_page)
            signal.signal(signal.SIGUSR2, fail_page)
            say("door", server.door_id)
            while json.loads(session.latest.text)["phase"] != "driving":
                time.sleep(0.05)
            session.ask(GoToPose(type="goal", x_m=_GOAL[0], y_m=_GOAL[1]))
            while True:
                time.sleep(1.0)


def hall() -> OccupancyGrid:
    """Its map."""
    cell_m = 0.05
    width, height = np.rint((_HIGH - _LOW)[:2] / cell_m).astype(int) + 2
    kind = np.full((height, width), CellKind.FREE, np.uint8)
    kind[[0, -1]] = kind[:, [0, -1]] = CellKind.OBSTACLE
    low = _LOW - cell_m
    return OccupancyGrid.of_kinds(kind, np.zeros(kind.shape, bool), cell_m, (float(low[0]), float(low[1])))


@dataclass
class Watched:
    """One run.

    Attributes:
        part, fault: that it had.
        stop_s: until the motors were at zero for good; infinite where they never were.
        stop_m: what the wheels rolled until then.
        moved_later: whether the motors turned again after they had stood for a second.
        said: what the program said of the end; empty where it said nothing.
    """

    part: str
    fault: str
    speed_m_s: float = 0.0
    stop_s: float = math.inf
    stop_m: float = math.inf
    moved_later: bool = False
    said: str = ""
    rows: list[tuple[float, bool, float]] = field(default_factory=list)

    def judge(self, begin_s: float) -> None:
        """Find when the motors came to a stop: the first second without a duty."""
        (begin_m,) = [way_m for stamp_s, _, way_m in self.rows if stamp_s <= begin_s][-1:] or [0.0]
        driven = [(stamp_s, way_m) for stamp_s, is_driven, way_m in self.rows if is_driven and stamp_s > begin_s]
        last_s, last_m = begin_s, begin_m
        for stamp_s, way_m in driven:
            if stamp_s - last_s > 1.0:
                self.moved_later = True
                break
            last_s, last_m = stamp_s, way_m
        if self.rows[-1][0] - last_s > 1.0:
            self.stop_s, self.stop_m = last_s - begin_s, last_m - begin_m


def watched(part: str, fault: str, rng: np.random.Generator) -> Watched:
    """Run the program, break a part of it, and watch the motors."""
    found = Watched(part, fault)
    with TemporaryDirectory() as scratch, SimulatedController(Path(scratch)) as controller:
        motors = controller.motors = Motors()
        kind = "--served" if part in _OF_PAGE else "--program"
        command = [sys.executable, "-m", "benchmarks.silent_parts", kind, str(controller.port)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            lines: list[list[str]] = []
            reader = threading.Thread(target=lambda: lines.extend(line.split() for line in process.stdout or ()))
            reader.start()
            pids = {"program": process.pid}
            try:
                _until(lambda: any(line[1] == "ready" for line in lines), process)
                (ready,) = [line for line in lines if line[1] == "ready"]
                pids |= {"localization": int(ready[2]), "camera": int(ready[3]), "program": process.pid}
                if part in _OF_PAGE:
                    _until(lambda: any(line[1] == "door" for line in lines), process)
                    pids["door"] = next(int(line[2]) for line in lines if line[1] == "door")
                _until(lambda: float(motors.speeds_m_s.mean()) > 0.95 * SPEED_M_S, process)
                time.sleep(float(rng.uniform(0.0, 0.3)))
                found.speed_m_s = float(motors.speeds_m_s.mean())
                _watch(found, controller, pids.get(part, process.pid), lines)
            except NotDrivenError:
                found.rows.clear()
            finally:
                for pid in pids.values():
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                reader.join()
        found.said = next((" ".join(line[2:]) for line in lines if line[1] == "end"), "")
    return found


def driven(part: str, fault: str, rng: np.random.Generator, console: Console) -> Watched:
    """A run that came to drive: a busy computer may stop the robot before the fault, which is printed."""
    for _ in range(_STARTS):
        run = watched(part, fault, rng)
        if run.rows:
            return run
        console.print(f"{part} {fault}: did not come to drive; {run.said or 'it said nothing'}")
    raise SystemExit(f"the robot's program did not come to drive in {_STARTS} tries")


def _watch(found: Watched, controller: SimulatedController, pid: int, lines: list[list[str]]) -> None:
    is_thread = found.part in _THREADS
    stop, kill = (signal.SIGUSR1, signal.SIGUSR2) if is_thread else (signal.SIGSTOP, signal.SIGKILL)
    begin_s = time.monotonic()
    found.rows.append((begin_s, True, _way_m(controller)))
    os.kill(pid, stop if found.fault == "hangs" else kill)
    is_resumed, fault_s = is_thread or found.fault == "dies", begin_s
    waits_for_plan = found.part == "planner"
    until_s = begin_s + _RESUMED_S + _WATCHED_S
    while (now_s := time.monotonic()) < until_s:
        found.rows.append((now_s, any(controller.duties), _way_m(controller)))
        if not is_resumed and now_s > begin_s + _RESUMED_S:
            is_resumed = True
            with suppress(ProcessLookupError):  # a door that hung was replaced
                os.kill(pid, signal.SIGCONT)
        if waits_for_plan and fault_s == begin_s and any(line[1] == "fault" for line in lines):
            fault_s = next(float(line[0]) for line in lines if line[1] == "fault")
            until_s = fault_s + _RESUMED_S + _WATCHED_S
        time.sleep(0.002)
    found.judge(fault_s)


def _way_m(controller: SimulatedController) -> float:
    return (controller.left + controller.right) / 2 * _WHEELS.left_m_per_tick


def _until(is_so: Any, process: subprocess.Popen[str]) -> None:
    ends_s = time.monotonic() + _START_S
    while not is_so():
        if time.monotonic() > ends_s or process.poll() is not None:
            raise NotDrivenError
        time.sleep(0.01)


def sheets_of(runs: list[Watched]) -> list[Sheet]:
    """A row for each part and fault, and what must be reached."""
    header = ("part", "fault", "runs", "stop s, median", "stop s, most", "way m, most", "moved later", "it says")
    rows = []
    for part in PARTS:
        for fault in FAULTS:
            some = [run for run in runs if (run.part, run.fault) == (part, fault)]
            if some:
                stops = [run.stop_s for run in some]
                most_m, later = max(run.stop_m for run in some), sum(run.moved_later for run in some)
                figures = (f"{statistics.median(stops):.2f}", f"{max(stops):.2f}", f"{most_m:.2f}", str(later))
                rows.append((part, fault, str(len(some)), *figures, some[-1].said))
    return [Sheet("Outcomes", header, tuple(rows)), targets_sheet(targets_of(runs))]


def targets_of(runs: list[Watched]) -> list[Target]:
    """What must be reached."""
    return [
        Target(f"motors at zero, the longest of {len(runs)}", WITHIN_S, max(run.stop_s for run in runs), "s", 2),
        Target("way until then, the longest", WITHIN_M, max(run.stop_m for run in runs), "m", 2),
        Target("runs in which the motors turned again", 0, sum(run.moved_later for run in runs), "", 0),
    ]


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.silent_parts", description=__doc__)
    parser.add_argument("--times", type=int, default=20, help="runs of each part and fault")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=FAULTS)
    parser.add_argument("--seed", type=int, default=1, help="of the moments")
    parser.add_argument("--out", type=Path, help="page whose section is written, docs/benchmarks/navigation.md")
    parser.add_argument("--program", metavar="PORT", help=argparse.SUPPRESS)
    parser.add_argument("--served", metavar="PORT", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.program or arguments.served:
        program(arguments.program) if arguments.program else served_program(arguments.served)
        return
    console, runs, rng = Console(width=170), list[Watched](), np.random.default_rng(arguments.seed)
    for part in arguments.parts:
        for fault in arguments.faults:
            for number in range(arguments.times):
                run = driven(part, fault, rng, console)
                runs.append(run)
                facts = f"from {run.speed_m_s:.2f} m/s: {run.stop_s:.2f} s, {run.stop_m:.2f} m"
                again = ", moved later" if run.moved_later else ""
                console.print(f"{part} {fault} {number + 1}: {facts}{again}; {run.said}")
    for sheet in sheets_of(runs):
        console.print(sheet.to_rich())
    if arguments.out is not None:
        what = f"`python -m benchmarks.silent_parts --times {arguments.times} --seed {arguments.seed}`"
        write_section(arguments.out, _TITLE, __doc__ or "", machine.description() | {"Command": what}, sheets_of(runs))


if __name__ == "__main__":
    main()
