"""Clients of the live page, for a process of their own: they watch, click goals and press STOP."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable
from http.client import HTTPConnection
from typing import Any

from websockets.sync.client import ClientConnection, connect

_WAIT_S = 20.0
# Metres or radians a second.
_MOVES = 0.02
_DRIVES_M_S, _STILL = 0.1, 10
_ALIVE = '{"type": "alive"}'
_ALIVE_S = 0.5
_KINDS = {"plan": "png", "costmap": "png", "camera": "jpg"}


def watch(port: int, clients: int, seconds: float) -> list[tuple[int, int]]:
    """Updates and images that each of some clients got in a time."""
    found: list[tuple[int, int]] = []
    threads = [threading.Thread(target=lambda: found.append(_watch(port, seconds))) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return found


def click(port: int, goal: tuple[float, float], times: int, longest_s: float) -> list[tuple[float, float]]:
    """When a goal was clicked, and when the page showed that the robot moves, by the common clock of all processes.

    After each it is stopped, and waited for until it stands. Raises TimeoutError where it does not move, or stand.
    """
    found = []
    with _opened(port) as socket:
        for _ in range(times):
            # After a stop a chair rocks.
            _until(socket, _Still(), longest_s)
            clicked_s = time.monotonic()
            socket.send(json.dumps({"type": "goal", "x_m": goal[0], "y_m": goal[1], "yaw_rad": None}))
            _until(socket, _moves, longest_s)
            found.append((clicked_s, time.monotonic()))
            _until(socket, lambda robot: abs(robot["speed_m_s"]) > _DRIVES_M_S, longest_s)
            socket.send('{"type": "stop"}')
    return found


class _Still:
    """Whether a robot stands, and stood each of the last times that this was asked."""

    def __init__(self) -> None:
        self._last = deque([False] * _STILL, maxlen=_STILL)

    def __call__(self, robot: dict[str, Any]) -> bool:
        self._last.append(not _moves(robot))
        return all(self._last)


def _moves(robot: dict[str, Any]) -> bool:
    return bool(abs(robot["speed_m_s"]) >= _MOVES or abs(robot["turn_rad_s"]) >= _MOVES)


def press(port: int, times: int, every_s: float) -> list[float]:
    """When STOP was pressed, by the clock that all processes share."""
    pressed = []
    with _opened(port) as socket:
        # What is sent is not kept waiting by what no one reads.
        reading = threading.Thread(target=lambda: [None for _ in socket], daemon=True)
        reading.start()
        for _ in range(times):
            time.sleep(every_s)
            pressed.append(time.monotonic())
            socket.send('{"type": "stop"}')
        time.sleep(every_s)
    return pressed


def _watch(port: int, seconds: float) -> tuple[int, int]:
    """As the page's script does: images are fetched as they change."""
    updates, images, numbers = 0, 0, dict[str, int]()
    connection = HTTPConnection("127.0.0.1", port, timeout=_WAIT_S)
    ends_s, alive_s = time.monotonic() + seconds, 0.0
    with _opened(port) as socket:
        socket.send('{"type": "costmap", "shown": true}')
        while time.monotonic() < ends_s:
            reported = json.loads(socket.recv(timeout=_WAIT_S))
            updates += "robot" in reported
            for name, picture in reported.get("robot", {}).get("pictures", {}).items():
                if numbers.get(name) != picture["number"]:
                    numbers[name] = picture["number"]
                    connection.request("GET", f"/{name}.{_KINDS[name]}?n={picture['number']}")
                    images += len(connection.getresponse().read()) > 0
            if time.monotonic() - alive_s > _ALIVE_S:
                alive_s = time.monotonic()
                socket.send(_ALIVE)
    connection.close()
    return updates, images


def _until(socket: ClientConnection, what: Callable[[dict[str, Any]], bool], longest_s: float) -> dict[str, Any]:
    """Return what the page reports of the robot once a condition holds. Raises TimeoutError."""
    ends_s, alive_s = time.monotonic() + longest_s, 0.0
    while time.monotonic() < ends_s:
        reported = json.loads(socket.recv(timeout=_WAIT_S))
        if time.monotonic() - alive_s > _ALIVE_S:
            alive_s = time.monotonic()
            socket.send(_ALIVE)
        if "robot" in reported and reported["robot"]["phase"] == "driving" and what(reported["robot"]):
            return dict(reported["robot"])
    raise TimeoutError("the robot does not do what it was asked")


def _opened(port: int) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/live", compression=None, open_timeout=_WAIT_S)
