"""`python -m benchmarks.live_page`: how quick the live page is, what it costs, and what it refuses.

A simulated robot (studio, 160×120 at 5 images a second, a new map) is driven in a thread by what pages ask; clients
are in a process of their own, and do what the page's script does. "Goal clicked to robot moving" ends
with the period in which a robot that stood truly moves, by 0.02 m/s or rad/s. "STOP to the stop command" ends
where the robot's own `stop` is called. The server's share of a core is the processor time of its thread by the wall's
clock, while three clients watch, costmap and all; images and text are made once for all, in the thread that drives.
Where the computer is too slow, simulated time goes slower than the wall's, and a robot begins to move later; so the
robot's own clock is given, too.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks import machine, page_clients
from benchmarks.page_requests import abroad, at_home, refusals
from benchmarks.table import Sheet, targets_sheet, write_page
from benchmarks.targets import Target
from wheelsight.app.page import Access, DriveMaps, Session
from wheelsight.app.page.server import PageServer, page_app
from wheelsight.config import load_config
from wheelsight.core.messages import Event, VelocityCommand
from wheelsight_sim import SimulationSettings
from wheelsight_sim.simulator import PERIOD_S, Simulator

MOVING_S, UPDATES_HZ, SHARE_PERCENT, STOP_MS, REFUSED = 0.5, 10.0, 10.0, 50.0, 24
CLIENTS, GOAL, MOVES = 3, (1.8, 0.0), 0.02
TOKEN = "0123456789abcdef0123456789abcdef"
_LONGEST_S = 60.0


class WatchedSimulator(Simulator):
    """Notes when it is stopped, and can hang.

    Attributes:
        stops_s: by the clock that all processes share.
        goes_on: cleared, its steps hang.
        steps: how many there were.
        moved: of each step, when it ended by the shared clock, the robot's own time, and whether it truly moved.
    """

    stops_s: list[float]
    goes_on: threading.Event
    steps = 0
    moved: list[tuple[float, float, bool]]

    def __enter__(self) -> WatchedSimulator:
        return self

    def step(self, command: VelocityCommand) -> list[Event]:
        """As `Simulator` has it."""
        self.goes_on.wait(_LONGEST_S)
        self.steps += 1
        before = self.T_world_base.copy()
        events = super().step(command)
        T = np.linalg.inv(before) @ self.T_world_base
        moves = max(float(np.hypot(T[0, 3], T[1, 3])), abs(float(np.arctan2(T[1, 0], T[0, 0])))) / PERIOD_S >= MOVES
        self.moved.append((time.monotonic(), self.time_s, moves))
        return events

    def stop(self) -> None:
        """As `Simulator` has it."""
        self.stops_s.append(time.monotonic())
        super().stop()


@dataclass(frozen=True, slots=True, eq=False)
class Running:
    """All that is measured."""

    robot: WatchedSimulator
    session: Session
    server: PageServer
    abroad: PageServer


@dataclass(frozen=True, slots=True)
class Load:
    """What watching costs.

    Attributes:
        clients: how many watched.
        updates_hz: that the one of them who got the fewest got.
        images_hz: likewise.
        server_percent: of a core.
        steps_hz: periods of the robot by the wall's clock.
        simulated: share of real time.
    """

    clients: int
    updates_hz: float
    images_hz: float
    server_percent: float
    steps_hz: float
    simulated: float

    @property
    def row(self) -> tuple[str, ...]:
        """Of the table."""
        figures = f"{self.updates_hz:.1f}", f"{self.images_hz:.1f}", f"{self.server_percent:.1f}"
        return str(self.clients), *figures, f"{self.steps_hz:.1f}", f"{100 * self.simulated:.0f}"


@contextmanager
def running(rate_hz: float) -> Iterator[Running]:
    """A robot that knows its place, and its page, for this computer and for others."""
    config = load_config(overrides={"odometry": "wheels,dense", "loops.source": "keyframes"})
    settings = SimulationSettings("studio", realism="real", rate_hz=rate_hz, size=(160, 120), camera="kinect-v1")
    with ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory()))
        robot = WatchedSimulator(settings, limits=config.navigation.limits)
        robot.stops_s, robot.moved, robot.goes_on = [], [], threading.Event()
        robot.goes_on.set()
        held.enter_context(robot)
        maps = DriveMaps(config, None, None, folder / "maps", in_step=True)
        session = held.enter_context(Session(robot, maps, config.page, paces=True))
        servers = [
            held.enter_context(PageServer(page_app(session, config.page, access), "127.0.0.1", 0, config.page))
            for access in (Access(True), Access(False, TOKEN))
        ]
        ends_s = time.monotonic() + 2 * _LONGEST_S
        while '"knows where it is"' not in session.latest.text or "plan" not in session.latest.pictures:
            if time.monotonic() > ends_s:
                raise RuntimeError("the robot does not find its place")
            time.sleep(0.1)
        time.sleep(5)  # what is translated or loaded at first use has been
        yield Running(robot, session, *servers)


def beside(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function answers in a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def watched(run: Running, clients: int, seconds: float) -> Load:
    """While so many clients watch, or none."""
    robot, began_s = run.robot, time.monotonic()
    before = cpu_s(run.server.thread_id), robot.steps, robot.time_s
    if clients:
        counts = beside(page_clients.watch, run.server.port, clients, seconds)
    else:
        time.sleep(seconds)
        counts = [(0, 0)]
    wall_s = time.monotonic() - began_s
    # A process takes a while to begin: its clients watch for `seconds`, and all else is measured over the whole.
    updates, images = (min(count) / seconds for count in zip(*counts, strict=True))
    share = (cpu_s(run.server.thread_id) - before[0]) / seconds
    steps_hz, simulated = (robot.steps - before[1]) / wall_s, (robot.time_s - before[2]) / wall_s
    return Load(clients, updates, images, 100 * share, steps_hz, simulated)


def cpu_s(thread: int) -> float:
    """Processor time of a thread so far."""
    fields = Path(f"/proc/self/task/{thread}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def moving(robot: WatchedSimulator, clicked_s: float, reported_s: float) -> tuple[float, float, float]:
    """Seconds from a click until the robot truly moves, by the wall's clock and its own, and until a page shows it."""
    own_s = max((time_s for wall_s, time_s, _ in robot.moved if wall_s <= clicked_s), default=0.0)
    wall_s, time_s = next((wall_s, time_s) for wall_s, time_s, moves in robot.moved if wall_s > clicked_s and moves)
    return wall_s - clicked_s, time_s - own_s, reported_s - clicked_s


def stop_ms(run: Running, times: int, every_s: float) -> list[float]:
    """From each press to the robot's stop; presses and stops alternate, since one is over before the next begins."""
    count = len(run.robot.stops_s)
    pressed = beside(page_clients.press, run.server.port, times, every_s)
    stopped = run.robot.stops_s[count:]
    if len(stopped) != times:
        raise RuntimeError(f"{times} presses made {len(stopped)} stops")
    return [1e3 * (stop_s - press_s) for press_s, stop_s in zip(pressed, stopped, strict=True)]


def main() -> None:
    """Print what was measured, and write it where asked to."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_page", description=__doc__)
    parser.add_argument("--rate", type=float, default=5.0, help="images a second")
    parser.add_argument("--goals", type=int, default=10)
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=20.0, help="for which clients watch")
    parser.add_argument("--out", type=Path, help="Markdown to write")
    arguments = parser.parse_args()
    about, console = machine.description(), Console(width=150)
    given = " ".join(f"--{name} {value:g}" for name, value in vars(arguments).items() if name != "out")
    about["Command"] = f"`python -m benchmarks.live_page {given}`"
    with running(arguments.rate) as run:
        loads = [watched(run, clients, arguments.seconds) for clients in (0, CLIENTS)]
        console.print(*loads)
        clicks = beside(page_clients.click, run.server.port, GOAL, arguments.goals, _LONGEST_S)
        moving_s = [moving(run.robot, *click) for click in clicks]
        console.print(moving_s)
        driven_ms = stop_ms(run, arguments.presses, 0.11)
        run.robot.goes_on.clear()
        hung_ms = stop_ms(run, arguments.presses, 0.11)
        run.robot.goes_on.set()
        bad = [*refusals(run.server.port, at_home()), *refusals(run.abroad.port, abroad())]
    sheets = sheets_of(loads, moving_s, driven_ms, hung_ms, bad)
    for sheet in sheets:
        console.print(sheet.to_rich())
    if arguments.out is not None:
        write_page(arguments.out, "The live page", __doc__ or "", about, sheets)


def sheets_of(
    loads: list[Load],
    moving_s: list[tuple[float, float, float]],
    driven_ms: list[float],
    hung_ms: list[float],
    bad: list[tuple[str, str, bool]],
) -> list[Sheet]:
    """What was measured, and what must be reached."""
    header = "clients", "updates/s", "images/s", "server, % of a core", "periods/s", "simulated time, % of real"
    moved, by_own, reported = (list(seconds) for seconds in zip(*moving_s, strict=True))
    rows = [
        _row("goal clicked to robot moving, s", moved, 2),
        _row("the same by the robot's clock, s", by_own, 2),
        _row("goal clicked to the page's confirmation, s", reported, 2),
        _row("STOP to the stop command, ms", driven_ms, 1),
        _row("the same while the robot's program hangs, ms", hung_ms, 1),
    ]
    refused = sum(is_refused for _, _, is_refused in bad)
    abroad_count = len(abroad())
    answered = sum(not is_refused for _, _, is_refused in bad[-abroad_count:])
    targets = [
        Target("goal clicked to robot moving, median", MOVING_S, float(np.median(moved)), "s", 2),
        Target("the same by the robot's clock, median", MOVING_S, float(np.median(by_own)), "s", 2),
        Target(f"updates to each of {CLIENTS} clients", UPDATES_HZ, loads[-1].updates_hz, "a second", 1, is_least=True),
        Target("server, of a core", SHARE_PERCENT, loads[-1].server_percent, "%"),
        Target("STOP to the stop command, median", STOP_MS, float(np.median(driven_ms)), "ms"),
        Target(f"STOP, worst of {len(driven_ms)}", STOP_MS, max(driven_ms), "ms"),
        Target(f"STOP while the program hangs, worst of {len(hung_ms)}", STOP_MS, max(hung_ms), "ms"),
        Target(f"bad requests refused, of {len(bad)}", REFUSED, refused, "", 0, is_least=True),
        Target(f"answered without the token, of {abroad_count}", 0, answered, "", 0),
    ]
    return [
        Sheet("Watching", header, tuple(load.row for load in loads)),
        Sheet("From a click on", ("what", "times", "median", "95 %", "worst"), tuple(rows)),
        Sheet("Refused", ("request", "what came of it"), tuple((name, came[:90]) for name, came, _ in bad)),
        targets_sheet(targets),
    ]


def _row(name: str, values: list[float], decimals: int) -> tuple[str, ...]:
    figures = np.median(values), np.percentile(values, 95), max(values)
    return name, str(len(values)), *(f"{value:.{decimals}f}" for value in figures)


if __name__ == "__main__":
    main()
