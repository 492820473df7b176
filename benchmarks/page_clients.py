"""Clients of the live page, for a process of their own: they watch, click goals and press STOP."""

from __future__ import annotations

import json
import threading
import time
from http.client import HTTPConnection
from typing import Any

from websockets.sync.client import ClientConnection, connect

_WAIT_S = 20.0
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


def click(port: int, goals: list[tuple[float, float]], moves_m_s: float, longest_s: float) -> list[float | None]:
    """Seconds from each goal's click until the page is told that the robot moves; None where that never was."""
    found = []
    with _opened(port) as socket:
        for x_m, y_m in goals:
            _until(socket, lambda robot: robot["state"] in ("idle", "arrived", "failed"), longest_s)
            _until(socket, lambda robot: abs(robot["speed_m_s"]) < 0.01 and abs(robot["turn_rad_s"]) < 0.01, longest_s)
            clicked_s = time.monotonic()
            socket.send(json.dumps({"type": "goal", "x_m": x_m, "y_m": y_m, "yaw_rad": None}))

            def moves(robot: dict[str, Any]) -> bool:
                return abs(robot["speed_m_s"]) > moves_m_s or abs(robot["turn_rad_s"]) > moves_m_s

            found.append(time.monotonic() - clicked_s if _until(socket, moves, longest_s) else None)
    return found


def press(port: int, times: int, every_s: float) -> list[float]:
    """When STOP was pressed, by the clock that all processes share."""
    pressed = []
    with _opened(port) as socket:
        # What is sent is not kept waiting by what nobody reads.
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
            told = json.loads(socket.recv(timeout=_WAIT_S))
            updates += "robot" in told
            for name, picture in told.get("robot", {}).get("pictures", {}).items():
                if numbers.get(name) != picture["number"]:
                    numbers[name] = picture["number"]
                    connection.request("GET", f"/{name}.{_KINDS[name]}?n={picture['number']}")
                    images += len(connection.getresponse().read()) > 0
            if time.monotonic() - alive_s > _ALIVE_S:
                alive_s = time.monotonic()
                socket.send(_ALIVE)
    connection.close()
    return updates, images


def _until(socket: ClientConnection, what: Any, longest_s: float) -> bool:
    """Whether something comes to be of the robot."""
    ends_s, alive_s = time.monotonic() + longest_s, 0.0
    while time.monotonic() < ends_s:
        told = json.loads(socket.recv(timeout=_WAIT_S))
        if time.monotonic() - alive_s > _ALIVE_S:
            alive_s = time.monotonic()
            socket.send(_ALIVE)
        if "robot" in told and told["robot"]["phase"] == "driving" and what(told["robot"]):
            return True
    return False


def _opened(port: int) -> ClientConnection:
    return connect(f"ws://127.0.0.1:{port}/live", compression=None, open_timeout=_WAIT_S)
