"""`wheelsight serve`: a page to see a robot and to lead it from a browser."""

from __future__ import annotations

from wheelsight.cli._serve_options import ServeOptions
from wheelsight.cli._serving import serve_there
from wheelsight.cli._takes import takes


@takes(ServeOptions)
def serve(options: ServeOptions) -> None:
    """Show a robot on a page, and lead it there: click a goal, name a place, save the map, STOP.

    The page is for this computer alone. --host of another address is reached from other computers and phones, by the
    address that is printed with a token; what they say is not encrypted. docs/live-page.md says who may do what.

    --robot asks once before anything moves, as drive does. Ctrl-C stops the robot first.

    [bold]Examples[/bold]

    wheelsight serve --sim studio --out maps

    wheelsight serve --sim flat --map home --known-start 0,0,0

    wheelsight serve --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --host 192.168.1.20
    """
    serve_there(options)
