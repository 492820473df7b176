"""A session of zenoh that stands for rmw_zenoh: its keys, tokens and attachments are written here from its description.

It is the router, too.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from links.bridged import Linked, linked
from live_page.room_session import ROOM, SIZE_M

from wheelsight.core.errors import ConfigError
from wheelsight_export.bag_writing import Messages
from wheelsight_ros2 import LinkSettings

zenoh = pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed")
TYPES = Messages(is_ros1=False).types
DOMAIN = 3
# Published with rmw_zenoh's own tests and by `ros2 interface show`: the hash of ROS's definition.
TWIST = "geometry_msgs::msg::dds_::Twist_/RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"


@contextmanager
def router() -> Iterator[tuple[Any, str]]:
    """A session that others connect to, and its address."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")
    with zenoh.open(config) as session:
        yield session, f"127.0.0.1:{port}"


@contextmanager
def met(namespace: str = "") -> Iterator[tuple[Linked, Any]]:
    with router() as (session, address):
        settings = LinkSettings(ros2="zenoh", domain=DOMAIN, namespace=namespace, interface=address)
        with linked(settings) as served:
            yield served, session


def until(what: Callable[[], Any], seconds: float = 30.0) -> Any:
    ends_s = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < ends_s
        time.sleep(0.02)
    return found


def decoded(sample: Any, type_: str) -> Any:
    return TYPES.deserialize_cdr(bytes(sample.payload), type_)


def test_topics_are_taken_and_commands_drive_the_robot() -> None:
    with met() as (served, session):
        odometry, maps = list[Any](), list[Any]()
        odom = session.declare_subscriber(f"{DOMAIN}/odom/nav_msgs::msg::dds_::Odometry_/*", odometry.append)
        until(lambda: len(odometry) > 5)
        # A sequence number, a time, and 16 bytes of a source behind their count.
        attachments = [bytes(one.attachment) for one in odometry]
        assert {len(one) for one in attachments} == {33}
        numbers = [struct.unpack_from("<q", one)[0] for one in attachments]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert abs(struct.unpack_from("<q", attachments[-1], 8)[0] / 1e9 - time.time()) < 60
        assert len({one[16:] for one in attachments}) == 1
        assert attachments[0][16] == 16
        # The map was sent before: as a late, transient local subscription asks for it.
        history = {"history": zenoh.ext.HistoryConfig(detect_late_publishers=True)}
        key = f"{DOMAIN}/map/nav_msgs::msg::dds_::OccupancyGrid_/*"
        late = zenoh.ext.declare_advanced_subscriber(session, key, maps.append, **history)
        grid = decoded(until(lambda: maps)[0], "nav_msgs/msg/OccupancyGrid")
        np.testing.assert_array_equal(grid.data, ROOM.grid(*SIZE_M).occupancy.ravel())
        publisher = session.declare_publisher(f"{DOMAIN}/cmd_vel/{TWIST}")
        twist = b"\x00\x01\x00\x00" + struct.pack("<6d", 0.3, 0, 0, 0, 0, 0)
        while served.robot.base.forward_m_s < 0.28:
            publisher.put(twist)
            time.sleep(0.02)
        speed = decoded(odometry[-1], "nav_msgs/msg/Odometry").twist.twist.linear.x
        assert speed > 0.2
        publisher.put(twist[:20])
        until(lambda: "is no geometry_msgs/msg/Twist" in " ".join(served.problems))
        served.until_stands()
        for one in (odom, late, publisher):
            one.undeclare()


def test_the_graph_has_the_node_with_its_topics() -> None:
    with met("/chair") as (_, session):

        def tokens() -> list[str]:
            return [str(reply.ok.key_expr) for reply in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**")]

        found = until(lambda: [one for one in [tokens()] if len(one) > 20])[0]
        parts = [one.split("/") for one in found]
        assert {len(one) for one in parts} == {9, 13}
        assert {one[8] for one in parts} == {"wheelsight"}
        by_topic = {one[9]: one for one in parts if len(one) == 13}
        twist, grid = by_topic["%chair%cmd_vel"], by_topic["%chair%map"]
        assert [twist[5], f"{twist[10]}/{twist[11]}", twist[12]] == ["MS", TWIST, "2::,1:,:,:,,"]
        assert [grid[5], grid[12]] == ["MP", ":1:,1:,:,:,,"]
        assert by_topic["%chair%odom"][12] == "::,10:,:,:,,"


@pytest.mark.slow
def test_a_flood_that_ends_leaves_the_robot_standing() -> None:
    with met() as (served, session):
        publisher = session.declare_publisher(f"{DOMAIN}/cmd_vel/{TWIST}")
        twist = b"\x00\x01\x00\x00" + struct.pack("<6d", 0.3, 0, 0, 0, 0, 0)
        ends_s = time.monotonic() + 30
        while served.robot.base.forward_m_s < 0.28 and time.monotonic() < ends_s:
            for _ in range(50):
                publisher.put(twist)
            time.sleep(0)
        assert served.robot.base.forward_m_s > 0.25
        publisher.undeclare()
        served.until_stands()


def test_a_router_that_is_not_there_holds_nothing_up() -> None:
    with linked(LinkSettings(ros2="zenoh", domain=DOMAIN, interface="127.0.0.1:9")) as served:
        served.until(lambda reported: reported["pose"] is not None)


@pytest.mark.parametrize("address", ["udp/here", "here:port", "a:99999", ""])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="of zenoh the router's address"):
        LinkSettings(ros2="zenoh", interface=address).check()
