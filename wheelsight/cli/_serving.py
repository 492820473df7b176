"""What `wheelsight serve` does: robot, session, page, until somebody ends it."""

from __future__ import annotations

import secrets
import threading
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from wheelsight.cli._console import print_note, print_warning
from wheelsight.cli._drive_inputs import check_robot, settings_of
from wheelsight.cli._drive_robots import robot_of
from wheelsight.errors import ConfigError
from wheelsight.interrupts import until_stopped
from wheelsight.live_page.counted_lines import CountedLines

if TYPE_CHECKING:
    from wheelsight.calibration import Calibration
    from wheelsight.cli._serve_options import PageOptions, ServeOptions
    from wheelsight.config import Config, StartSettings
    from wheelsight.live_page import Access, DriveMaps, Session
    from wheelsight.viewer import DriveLog

_PARTS = ("wheels", "dense", "joined", "loops", "navigation")
_LIBRARIES = ("starlette", "uvicorn", "websockets")
_TOKEN_BYTES, _SHORTEST_TOKEN = 24, 16
_LOOK_S = 0.1


class Refusals(CountedLines):
    """Warnings of the page, printed by a thread of its own, and counted where they repeat."""

    def __init__(self) -> None:
        super().__init__(lambda line: print_warning(line))


def serve_there(options: ServeOptions) -> None:
    """Until Ctrl-C, SIGTERM or SIGHUP. Raises what was handed in wrong, before anything moves."""
    from wheelsight.cli._compiling import compile_missing
    from wheelsight.cli._outputs import check_rerun
    from wheelsight.extras import needed

    for library in _LIBRARIES:
        needed(library)
    check_robot(options)
    # Where no map of before is driven in first, and on the page, a new one is made.
    config, access = settings_of(options, {"loops.source": "keyframes"}), access_of(options)
    maps = _maps_of(config, options)
    check_rerun(options.rerun)
    compile_missing((*_PARTS, *(("simulation",) if options.is_simulated else ())))
    with (
        Refusals() as lines,
        robot_of(options, config) as robot,
        _log_of(options.rerun, robot.calibration, config) as log,
    ):
        from wheelsight.live_page import Session

        on_problem = partial(lines.tell, is_problem=True)
        how: dict[str, Any] = {"paces": options.is_simulated, "on_problem": on_problem, "watch": log}
        with Session(robot, maps, config.page, **how) as session:
            _serve(session, config, access, options, lines)
            print_note("stopped; ending")


def _log_of(rerun: str | None, calibration: Calibration, config: Config) -> AbstractContextManager[DriveLog | None]:
    if rerun is None:
        return nullcontext()
    from wheelsight.viewer import open_drive_log

    return open_drive_log(rerun, calibration, config.viewer)


def access_of(options: PageOptions) -> Access:
    """Who may speak to the page. Raises ConfigError."""
    from wheelsight.live_page import Access, is_loopback

    token = options.token
    if token is not None and (len(token) < _SHORTEST_TOKEN or not token.isascii() or not token.isalnum()):
        raise ConfigError("--token can be guessed, or is no word", fix=f"{_SHORTEST_TOKEN} letters and digits, or more")
    at_home = is_loopback(options.host)
    if token is None:
        token = "" if at_home else secrets.token_hex(_TOKEN_BYTES)
    return Access(at_home, token)


def _maps_of(config: Config, options: ServeOptions) -> DriveMaps:
    from wheelsight.live_page import DriveMaps

    if options.known_start is not None and options.map_ is None:
        raise ConfigError("--known-start is of a map", fix="--map DIR")
    start = None if options.known_start is None else _start_of(options.known_start)
    return DriveMaps(config, options.map_, start, options.out, in_step=options.is_simulated)


def _start_of(text: str) -> StartSettings:
    import math

    from wheelsight.cli._map_names import pose_of
    from wheelsight.config import StartSettings

    x_m, y_m, yaw = pose_of("--known-start", text).tolist()
    if math.isnan(yaw):
        raise ConfigError(f"--known-start is {text!r}", fix="X,Y,YAW_DEG in metres and degrees, such as 3.2,1.5,90")
    return StartSettings(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(yaw))


def _serve(session: Session, config: Config, access: Access, options: ServeOptions, lines: Refusals) -> None:
    from wheelsight.live_page.app import page_app
    from wheelsight.live_page.server import PageServer

    app = page_app(session, config.page, access, lines.tell)
    with until_stopped() as is_over, PageServer(app, options.host, options.port, config.page) as server:
        for address in addresses(options.host, server.port, access.token):
            typer.echo(address)
        if access.token and not access.is_loopback:
            print_warning("what pages say is not encrypted: on a network that you trust alone")
        waiting = threading.Event()
        while not is_over():
            waiting.wait(_LOOK_S)
        # Before what takes its time, such as to close pages and to write a map.
        session.stop("the program ends")


def addresses(host: str, port: int, token: str) -> list[str]:
    """Where the page is, for people."""
    import socket

    if host in ("0.0.0.0", "::", ""):
        host = socket.gethostname()
    elif ":" in host:
        host = f"[{host}]"
    return [f"http://{host}:{port}/" + (f"?token={token}" if token else "")]
