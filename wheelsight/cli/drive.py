"""`wheelsight drive`: a robot goes to places of a map by itself."""

from __future__ import annotations

from wheelsight.cli._drive_options import DriveOptions
from wheelsight.cli._driving import drive_there
from wheelsight.cli._takes import takes


@takes(DriveOptions)
def drive(options: DriveOptions) -> None:
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

    wheelsight drive --sim flat --map home --follow drive/trajectory.txt --back

    wheelsight drive --robot /dev/ttyUSB0 --camera any --calibration robot.yaml --map home --to kitchen

    wheelsight drive --sim flat --map home --known-start 0,0,0 --to kitchen --set navigation.limits.forward_m_s=0.5
    """
    drive_there(options)
