"""`wheelsight serve`: a page to watch and drive a robot from a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from wheelsight.app.cli.console import CountedLines, print_note, print_warning, takes
from wheelsight.app.cli.drive import check_robot, kernels_of, maps_of, robot_of, session_of, settings_of, wait_for_end
from wheelsight.app.cli.drive_options import KnownStart, MapPath, Rate, Rerun, RobotOptions, SettingsOptions
from wheelsight.app.cli.options import OUTPUT, LinkOptions, option_field
from wheelsight.core.runtime import until_stopped

if TYPE_CHECKING:
    from wheelsight.app.page import Access


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
        session_of(robot, maps, options, config, links, lines) as session,
    ):
        app = page_app(session, config.page, access, lines.add)
        with until_stopped() as is_over, PageServer(app, options.host, options.port, config.page) as server:
            for address in addresses(options.host, server.port, access.token):
                typer.echo(address)
            if access.token and not access.is_loopback:
                print_warning("what pages say is not encrypted: on a network that you trust alone")
            wait_for_end(session, is_over)
        print_note("stopped; ending")


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
