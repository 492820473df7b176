"""`wheelsight drive`: a robot goes to places of a map by itself."""

from __future__ import annotations

from wheelsight.cli import _drive_options as options
from wheelsight.cli import _drive_robot_options as robots
from wheelsight.cli._options import Profile


def drive(
    map_: options.MapPath = None,
    to: options.To = None,
    back: options.Back = False,
    explore: options.Explore = False,
    known_start: options.KnownStart = None,
    out: options.Out = None,
    config: options.SettingsFile = None,
    profile: Profile = None,
    set_: options.Set = None,
    rerun: options.Rerun = None,
    force: options.Force = False,
    sim: robots.Sim = None,
    resolution: robots.Resolution = None,
    start: robots.Start = None,
    seed: robots.Seed = 0,
    day: robots.Day = 0,
    people: robots.People = 0,
    realism: robots.Realism = "real",
    camera: robots.CameraName = None,
    size: robots.Size = "half",
    rate: robots.Rate = 10.0,
    robot: robots.RobotPort = None,
    calibration: robots.CalibrationFile = None,
    baud: robots.Baud = 115200,
    yes: robots.Yes = False,
) -> None:
    """Drive to places of a known map, or explore: simulated, or with a robot on a serial port.

    The robot finds itself in the map, plans, drives around what is in its way, and stops where it must; docs/safety.md
    says what stops it and what does not. A terminal shows plan, state, speed and why it does what it does; else a line
    a second tells. Ctrl-C stops the robot first.

    --robot asks once before anything moves. It needs a live camera (wheelsight devices), whose own calibration is laid
    under --calibration.

    Exit code 0: arrived; 1: not, and why is said; 2: what was handed in is wrong; 130: interrupted.

    [bold]Examples[/bold]

    wheelsight drive --sim flat --explore --out home

    wheelsight drive --sim flat --map home --to kitchen --out drive

    wheelsight drive --sim flat --map home --to kitchen --rerun drive.rrd

    wheelsight drive --sim flat --day 1 --map home --to 3.2,1.5,90 --to desk --back

    wheelsight drive --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --to kitchen

    wheelsight drive --sim flat --map home --known-start 0,0,0 --to kitchen --set navigation.limits.forward_m_s=0.5
    """
    from wheelsight.cli._drive_inputs import Asked, Real, Simulated
    from wheelsight.cli._driving import drive_there
    from wheelsight.devices.robot_camera import ANY

    given = tuple(set_ or ())
    asked = Asked(map_, tuple(to or ()), back, explore, known_start, out, force, config, profile, given, rerun)
    simulated = Simulated(sim, resolution, start, seed, day, people, realism, camera or "kinect-v1", size, rate)
    drive_there(asked, simulated, Real(robot, calibration, baud, yes, camera or ANY))
