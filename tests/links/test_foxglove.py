"""A plain client reads what Foxglove's server says, leads the robot by it, and cannot harm it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from links.bridged import GOAL, TOKEN, Linked, linked
from links.foxglove_client import FoxgloveClient

from wheelsight_ros2 import LinkSettings


@pytest.fixture
def served() -> Iterator[Linked]:
    with linked(LinkSettings(foxglove="0", token=TOKEN)) as session:
        yield session


def test_channels_schemas_and_messages_are_read_and_a_goal_is_driven_to(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.subscribe(
            "/tf", "/odom", "/wheelsight/pose", "/map", "/plan", "/wheelsight/status", "/diagnostics", "/clock"
        )
        assert client.about["name"] == "wheelsight"
        assert client.last("/map").info.resolution == pytest.approx(0.05)
        client.advertise(1, "/goal_pose", "geometry_msgs/PoseStamped")
        client.publish(1, GOAL)
        client.until(lambda: client.last("/wheelsight/pose").pose.pose.position.x > 4.8)
        print(
            client.last("/tf"),
            client.last("/plan").poses[:1],
            client.last("/wheelsight/status"),
            client.last("/diagnostics"),
        )
        print(served.problems)
