"""How soon a robot stops once the program that drives it by /cmd_vel is killed, over Foxglove and over DDS.

    PYTHONPATH=.:tests python tests/links/measure_stops.py

A robot in a room, without images to render, is driven in real time at 0.5 m/s by another process, which is killed.
Printed are the times until the robot's command falls below what was commanded, and until it stands.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from pathlib import Path

from links.bridged import TOKEN, Linked, linked

from wheelsight_ros2 import LinkSettings

ROUNDS, SPEED_M_S, DOMAIN = 5, 0.5, 91
_FOXGLOVE = """
import sys, time
from links.foxglove_client import FoxgloveClient
with FoxgloveClient(sys.argv[1]) as client:
    client.advertise(1, "/cmd_vel", "geometry_msgs/msg/Twist")
    while True:
        client.publish(1, {"linear": {"x": float(sys.argv[2])}, "angular": {"z": 0.0}})
        time.sleep(0.05)
"""
_DDS = '{"topic": "cmd_vel", "v": %s, "w": 0.0, "every_s": 0.05}\n' % SPEED_M_S  # noqa: UP031 - JSON has braces


def killed(served: Linked, way: str) -> tuple[float, float]:
    """Seconds from the kill until the first slower command, and until the robot stands."""
    if way == "foxglove":
        command = [sys.executable, "-c", _FOXGLOVE, served.address, str(SPEED_M_S)]
    else:
        peer = Path(__file__).with_name("dds_peer.py")
        command = [sys.executable, str(peer), str(DOMAIN)]
    program = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert program.stdin is not None
    if way == "dds":
        program.stdin.write(_DDS)
        program.stdin.flush()
    while served.robot.base.forward_m_s < SPEED_M_S - 0.01:
        time.sleep(0.002)
    program.kill()
    killed_s = time.monotonic()
    while served.robot.commands[-1].forward_m_s > SPEED_M_S - 0.02:
        time.sleep(0.001)
    slower_s = time.monotonic() - killed_s
    while not (served.robot.commands[-1].is_stop and served.stands):
        time.sleep(0.001)
    stands_s = time.monotonic() - killed_s
    program.wait()
    program.stdin.close()
    return slower_s, stands_s


def main() -> None:
    """Measure both ways."""
    for way, settings in (
        ("foxglove", LinkSettings(foxglove="0", token=TOKEN)),
        ("dds", LinkSettings(ros2="dds", domain=DOMAIN)),
    ):
        found = []
        for _ in range(ROUNDS):
            with linked(settings) as served:
                found.append(killed(served, way))
        slower, stands = zip(*found, strict=True)
        for name, values in (("slower", slower), ("stands", stands)):
            middle, most = statistics.median(values), max(values)
            sys.stdout.write(f"{way}: {name} after {middle:.2f} s, {most:.2f} s at most, {ROUNDS} kills\n")


if __name__ == "__main__":
    main()
