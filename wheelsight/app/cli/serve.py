"""`wheelsight serve`: a page to watch and drive a robot from a browser. CountedLines limits the output on the
terminal.
"""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Self

import typer

from wheelsight.app.cli.console import print_note, print_warning, takes
from wheelsight.app.cli.drive import check_robot, kernels_of, robot_of, settings_of, start_of
from wheelsight.app.cli.drive_options import KnownStart, MapPath, Rate, Rerun, RobotOptions, SettingsOptions
from wheelsight.app.cli.options import OUTPUT, LinkOptions, option_field
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import until_stopped

if TYPE_CHECKING:
    from wheelsight.app.cli.drive_options import DriveOptions
    from wheelsight.app.page import Access, DriveMaps, Session, Watch
    from wheelsight.config import Config
    from wheelsight.core.robots import Robot
    from wheelsight_export import DriveLog
    from wheelsight_ros2 import Bridge, LinkSettings


_PAGE = "The page"


@dataclass(frozen=True)
class PageOptions:
    """Options of maps and of the page."""

    map_: MapPath = None
    known_start: KnownStart = None
    out: Path | None = option_field(
        "Folder for maps that are made, each in one of its own; those that are there can be driven in.",
        "DIR",
        "none",
        OUTPUT,
    )
    rerun: Rerun = None
    host: str = option_field(
        "Where the page is served: this computer alone, or, behind a token, any that reaches the address.",
        "ADDRESS",
        default="127.0.0.1",
        panel=_PAGE,
    )
    port: int = option_field("0: any that is free.", default=8765, panel=_PAGE, min=0, max=65535)
    token: str | None = option_field(
        "What each request must hold; 16 letters and digits at least.",
        "TEXT",
        "a new one; none on this computer alone",
        _PAGE,
    )


@dataclass(frozen=True)
class ServeOptions(LinkOptions, RobotOptions, SettingsOptions, PageOptions):
    """All options; fields of the last base come first."""

    rate: Rate = 5.0


@takes(ServeOptions)
def serve(options: ServeOptions) -> None:
    """Show a robot on a page, and lead it there: click a goal, name a place, save the map, STOP.

    The page is for this computer alone. --host of another address is reached from other computers and phones, by the
    address that is printed with a token; what they say is not encrypted. docs/live-page.md says who may do what.

    --robot asks once before anything moves, as drive does. Ctrl-C stops the robot first.

    [bold]Examples[/bold]

    wheelsight serve --sim studio --out maps
    wheelsight serve --sim flat --map home --known-start 0,0,0
    wheelsight serve --sim flat --map home --foxglove 8766 --ros2 dds
    wheelsight serve --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --host 192.168.1.20
    """
    from wheelsight.app.cli.compiling import compile_missing
    from wheelsight.app.cli.options import check_rerun, link_settings
    from wheelsight.core.runtime import needed

    for library in ("starlette", "uvicorn", "websockets"):
        needed(library)
    check_robot(options)
    # Where no map of before is driven in first, and on the page, a new one is made.
    config, access = settings_of(options, {"loops.source": "keyframes"}), access_of(options)
    from wheelsight.app.page.server import PageServer, page_app

    maps, links = maps_of(options, config), link_settings(options)
    check_rerun(options.rerun)
    compile_missing(kernels_of(options))
    with (
        CountedLines(print_warning) as lines,
        robot_of(options, config) as robot,
        _session_of(robot, maps, options, config, links, lines) as session,
    ):
        app = page_app(session, config.page, access, lines.add)
        with until_stopped() as is_over, PageServer(app, options.host, options.port, config.page) as server:
            for address in addresses(options.host, server.port, access.token):
                typer.echo(address)
            if access.token and not access.is_loopback:
                print_warning("what pages say is not encrypted: on a network that you trust alone")
            _wait(session, is_over)
        print_note("stopped; ending")


def be_led(robot: Robot, options: DriveOptions, config: Config, links: LinkSettings) -> None:
    """Drive in a known map as other programs ask, without a page, until Ctrl-C. Raises as `drive`."""
    maps = maps_of(options, config)
    with (
        CountedLines(print_warning) as lines,
        _session_of(robot, maps, options, config, links, lines) as session,
    ):
        with until_stopped() as is_over:
            _wait(session, is_over)
        print_note("stopped; ending")


@contextmanager
def _session_of(
    robot: Robot,
    maps: DriveMaps,
    options: ServeOptions | DriveOptions,
    config: Config,
    links: LinkSettings | None,
    lines: CountedLines,
) -> Iterator[Session]:
    """A session that Rerun shows and other programs lead, where options ask for them."""
    from wheelsight.app.cli.options import linked
    from wheelsight.app.page import Session
    from wheelsight_export import open_drive_log

    rerun, on_problem = options.rerun, partial(lines.add, is_problem=True)
    with (
        nullcontext() if rerun is None else open_drive_log(rerun, robot.calibration, config.viewer) as log,
        linked(
            links, robot.calibration, config, lambda: robot.now_s, lines.add, is_simulated=options.is_simulated
        ) as bridge,
        Session(
            robot,
            maps,
            config.page,
            paces=options.is_simulated,
            on_problem=on_problem,
            watch=watch_of(log, bridge),
        ) as session,
    ):
        if bridge is not None:
            bridge.lead(session)
        yield session


def _wait(session: Session, is_over: Callable[[], bool]) -> None:
    """Wait for the end of the program, and stop the robot before slow work, as closing pages and writing a map."""
    waiting = threading.Event()
    while not is_over():
        waiting.wait(_LOOK_S)
    session.stop("the program ends")


def watch_of(log: DriveLog | None, bridge: Bridge | None) -> Watch | None:
    """One listener of those that there are."""
    if log is None or bridge is None:
        return log or bridge
    from wheelsight_ros2 import Watches

    return Watches(log, bridge)


def maps_of(options: ServeOptions | DriveOptions, config: Config) -> DriveMaps:
    """The maps to drive in. Raises ConfigError, MapError."""
    from wheelsight.app.page import DriveMaps
    from wheelsight.config import StartSettings

    start = None
    if options.known_start is not None:
        if options.map_ is None:
            raise ConfigError("--known-start is of a map", fix="--map DIR")
        x_m, y_m, yaw = start_of("--known-start", options.known_start)
        start = StartSettings(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(yaw))
    return DriveMaps(config, options.map_, start, options.out, in_step=options.is_simulated)


_LOOK_S, _ENDS_S = 0.1, 2.0
# Different lines of refusals at once, and one more each 10 s: less than 1 MB a day. Up to 10 minutes apart.
_NEW_LINES, _NEW_LINE_S, _LONGEST_S = 8.0, 10.0, 600.0
_TIMES = re.compile(r" \((\d+) times\)$")


class CountedLines:
    """Shows lines from its own thread, so that a blocked terminal blocks no other thread; counts repeats.

    A line that comes again and again is shown with its count after 1 s, 2 s, 4 s and so on, up to 10 minutes. Of lines
    that differ, which a stranger can make up, few are shown, and the others counted.

    Args:
        show: called with a line, in that thread.
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._lines: dict[str, _Line] = {}
        self._left, self._filled_s = _NEW_LINES, time.monotonic()
        self._changed, self._is_over = threading.Condition(), False
        self._thread = threading.Thread(target=self._run, name="wheelsight-lines", daemon=True)
        self._thread.start()

    def add(self, line: str, *, is_problem: bool = False) -> None:
        """Add a line. Problems of the robot are always shown."""
        found = _TIMES.search(line)
        text, times = (line[: found.start()], int(found[1])) if found else (line, 1)
        now_s = time.monotonic()
        with self._changed:
            if text not in self._lines and not is_problem:
                self._left = min(self._left + (now_s - self._filled_s) / _NEW_LINE_S, _NEW_LINES)
                self._filled_s = now_s
                if self._left < 1:
                    text = "refused others"
                else:
                    self._left -= 1
            kept = self._lines.setdefault(text, _Line(due_s=now_s))
            kept.times += times
            self._changed.notify()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Print the remaining lines, and end."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_ENDS_S)

    def _run(self) -> None:
        while True:
            with self._changed:
                is_over = self._is_over
                # Lines to print with their counts; lines that have not come for long are removed
                now_s = math.inf if is_over else time.monotonic()
                printed = []
                for known_text, said in list(self._lines.items()):
                    if said.times and said.due_s <= now_s:
                        printed.append((known_text, said.times))
                        said.times, said.due_s = 0, now_s + said.wait_s
                        said.wait_s = min(2 * said.wait_s, _LONGEST_S)
                    elif not said.times and said.due_s + said.wait_s < now_s:
                        del self._lines[known_text]
                if not printed and not is_over:
                    waits = any(line.times for line in self._lines.values())
                    self._changed.wait(_LOOK_S if waits else None)
                    continue
            for text, times in printed:
                with suppress(OSError):
                    self._show(text if times == 1 else f"{text} ({times} times)")
            if is_over:
                return


@dataclass
class _Line:
    """Number of repeats of a line since it was printed, and the time of its next print."""

    due_s: float
    wait_s: float = 1.0
    times: int = 0


def access_of(options: PageOptions) -> Access:
    """The rules for requests to the page. Raises ConfigError."""
    from wheelsight.app.page import Access, is_loopback, token_of

    at_home = is_loopback(options.host)
    token = "" if options.token is None and at_home else token_of("--token", options.token)
    return Access(at_home, token)


def addresses(host: str, port: int, token: str) -> list[str]:
    """URLs of the page."""
    import socket

    if host in ("0.0.0.0", "::", ""):
        host = socket.gethostname()
    elif ":" in host:
        host = f"[{host}]"
    return [f"http://{host}:{port}/" + (f"?token={token}" if token else "")]
