"""`wheelsight serve`: a page to see a robot and to lead it from a browser."""

from __future__ import annotations

from wheelsight.cli import _drive_options as options
from wheelsight.cli import _drive_robot_options as robots
from wheelsight.cli import _serve_options as serve_options
from wheelsight.cli._options import Profile


def serve(
    map_: options.MapPath = None,
    known_start: options.KnownStart = None,
    out: serve_options.MapsFolder = None,
    host: serve_options.Host = "127.0.0.1",
    port: serve_options.Port = 8765,
    token: serve_options.Token = None,
    config: options.SettingsFile = None,
    profile: Profile = None,
    set_: options.Set = None,
    sim: robots.Sim = None,
    resolution: robots.Resolution = None,
    start: robots.Start = None,
    seed: robots.Seed = 0,
    day: robots.Day = 0,
    people: robots.People = 0,
    realism: robots.Realism = "real",
    camera: robots.CameraName = None,
    size: robots.Size = "half",
    rate: serve_options.Rate = 5.0,
    robot: robots.RobotPort = None,
    calibration: robots.CalibrationFile = None,
    baud: robots.Baud = 115200,
    yes: robots.Yes = False,
) -> None:
    """Show a robot on a page, and lead it there: click a goal, name a place, save the map, STOP.

    The page is for this computer alone. --host of another address is reached from other computers and phones, by the
    address that is printed with a token; what they say is not encrypted. docs/live-page.md says who may do what.

    --robot asks once before anything moves, as drive does. Ctrl-C stops the robot first.

    [bold]Examples[/bold]

    wheelsight serve --sim studio --out maps

    wheelsight serve --sim flat --map home --known-start 0,0,0

    wheelsight serve --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --host 192.168.1.20
    """
    from wheelsight.cli._drive_inputs import Asked, Real, Simulated
    from wheelsight.cli._serving import Served, serve_there
    from wheelsight.devices.robot_camera import ANY

    # Where no map of before is driven in first, and on the page, a new one is made.
    asked = Asked(None, (), False, True, None, out, False, config, profile, tuple(set_ or ()))
    simulated = Simulated(sim, resolution, start, seed, day, people, realism, camera or "kinect-v1", size, rate)
    real = Real(robot, calibration, baud, yes, camera or ANY)
    serve_there(asked, simulated, real, Served(map_, known_start, host, port, token))
