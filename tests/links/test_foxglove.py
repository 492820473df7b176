"""A plain client reads what Foxglove's server says, leads the robot by it, and cannot harm it."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from links.bridged import GOAL, HEADER, PLACE, TOKEN, Linked, linked
from links.foxglove_client import PROTOCOL, FoxgloveClient
from live_page.room_session import ROOM, SIZE_M
from websockets.exceptions import ConnectionClosed, InvalidStatus

from wheelsight.core.errors import ConfigError
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import TOPICS
from wheelsight_ros2 import FoxgloveServer, Inputs, LinkSettings

STATUS = "/wheelsight/status"


@pytest.fixture
def served() -> Iterator[Linked]:
    with linked(LinkSettings(foxglove="0", token=TOKEN)) as session:
        yield session


def velocity(forward_m_s: Any, turn_rad_s: Any = 0.0) -> dict[str, Any]:
    return {"linear": {"x": forward_m_s, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": turn_rad_s}}


def state(client: FoxgloveClient) -> dict[str, Any]:
    return json.loads(client.last(STATUS).data)


def test_channels_schemas_and_messages_are_read_and_a_goal_is_driven_to(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.subscribe("/tf", "/odom", "/wheelsight/pose", "/map", "/plan", STATUS, "/diagnostics", "/clock")
        grid, expected = client.last("/map"), ROOM.grid(*SIZE_M)
        assert (grid.info.height, grid.info.width) == expected.occupancy.shape
        assert list(grid.data) == expected.occupancy.ravel().tolist()
        client.advertise(1, "/goal_pose", "geometry_msgs/PoseStamped")
        client.publish(1, GOAL)
        client.until(lambda: client.last("/plan").poses)
        end = client.last("/plan").poses[-1].pose.position
        assert (end.x, end.y) == pytest.approx((5.0, 3.0), abs=0.1)
        client.until(lambda: state(client)["state"] == "arrived")
        client.messages["/tf"].clear()
        stamp_ns, tf = client.until(lambda: client.messages["/tf"])[-1]
        parents = [(one.header.frame_id, one.child_frame_id) for one in tf.transforms]
        assert parents == [("map", "odom"), ("odom", "base_link")]
        assert stamp_ns == tf.transforms[0].header.stamp.sec * 10**9 + tf.transforms[0].header.stamp.nanosec
        pose = client.last("/wheelsight/pose").pose.pose.position
        assert (pose.x, pose.y) == pytest.approx(served.robot.base.pose[:2], abs=0.02)
        assert [one.name for one in client.last("/diagnostics").status] == [
            "wheelsight: localization",
            "wheelsight: navigator",
            "wheelsight: collision monitor",
        ]
    assert served.problems == []


def test_who_comes_late_gets_maps_and_mounts(served: Linked) -> None:
    served.until(lambda reported: reported["pose"] is not None)
    with FoxgloveClient(served.address) as client:
        client.subscribe("/tf_static", "/map", "/wheelsight/calibration")
        frames = {one.child_frame_id for one in client.last("/tf_static").transforms}
        assert frames >= {"camera_link", "camera_depth_optical_frame", "camera_scan"}
        assert "ticks_per_turn" in client.last("/wheelsight/calibration").data
        client.last("/map")


@pytest.mark.parametrize("encoding", ["json", "cdr", "stamped"])
def test_a_stick_drives_and_the_robot_stops_when_its_program_vanishes(served: Linked, encoding: str) -> None:
    types = Messages(is_ros1=False).types
    type_ = "geometry_msgs/msg/TwistStamped" if encoding == "stamped" else "geometry_msgs/msg/Twist"
    said: dict[str, Any] | bytes = velocity(0.4)
    if encoding == "cdr":
        vector = types.types["geometry_msgs/msg/Vector3"]
        said = bytes(types.serialize_cdr(types.types[type_](vector(0.4, 0.0, 0.0), vector(0.0, 0.0, 0.0)), type_))
    elif encoding == "stamped":
        said = {"header": HEADER, "twist": said}
    with FoxgloveClient(served.address) as client:
        client.subscribe(STATUS)
        client.advertise(7, "/cmd_vel", type_, "cdr" if encoding == "cdr" else "json")
        ends_s = time.monotonic() + 60
        while served.robot.base.forward_m_s < 0.38:
            assert time.monotonic() < ends_s
            client.publish(7, said)
            client.read(0.02)
        client.until(lambda: state(client)["doing"] == "by hand")
        client.connection.socket.shutdown(socket.SHUT_RDWR)  # as a program that is killed
    served.until_stands()
    served.until(lambda reported: reported["state"] == "idle")


@pytest.mark.slow
def test_the_end_of_a_connection_ends_its_command(served: Linked, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without waiting for the command's time to pass."""
    monkeypatch.setattr("wheelsight_ros2.inputs.TIMEOUT_S", 1000.0)
    monkeypatch.setattr("wheelsight_ros2.inputs._REST_S", 1000.0)
    with FoxgloveClient(served.address) as driver, FoxgloveClient(served.address) as other:
        driver.advertise(2, "/cmd_vel", "geometry_msgs/msg/Twist")
        driver.publish(2, velocity(0.3))
        driver.until(lambda: served.robot.base.forward_m_s > 0.2)
        other.connection.socket.shutdown(socket.SHUT_RDWR)
        driver.until(lambda: served.robot.base.pose[0] > 2.2)
        assert not served.robot.commands[-1].is_stop, "another client ends nothing"
        driver.connection.socket.shutdown(socket.SHUT_RDWR)
        served.until_stands()
    assert served.problems == []


def test_an_address_of_all_networks_is_shown_by_name() -> None:
    try:
        server = FoxgloveServer("[::]:0", TOKEN, Inputs(lambda: 0.0), lambda *_: None, lambda line: None)
    except ConfigError:
        pytest.skip("this computer has no IPv6")
    try:
        assert server.address == f"ws://{socket.gethostname()}:{server.port}/?token={TOKEN}"
    finally:
        server.close()


def test_a_stick_before_a_wall_is_held_by_the_collision_monitor(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.advertise(7, "/cmd_vel", "geometry_msgs/Twist")
        ends_s = time.monotonic() + 60.0
        while not (served.robot.now_s > 4 and served.stands) and time.monotonic() < ends_s:
            client.publish(7, velocity(1.0))
            time.sleep(0.05)
        corners = served.robot.base.pose[0]
        assert served.stands
        assert 6.0 < corners < 7.6  # of 8 m, less its front
        assert served.robot.commands[-1].is_stop


@pytest.mark.slow
def test_nonsense_is_refused_and_the_robot_goes_on_by_its_own_plan(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.subscribe(STATUS)
        client.advertise(1, "/goal_pose", "geometry_msgs/PoseStamped")
        client.publish(1, GOAL)
        client.until(lambda: state(client)["state"] == "driving")
        client.advertise(2, "/cmd_vel", "geometry_msgs/msg/Twist")
        client.advertise(3, "/cmd_vel", "geometry_msgs/msg/Twist", "cdr")
        old = {"frame_id": "map", "stamp": {"sec": 10**6, "nsec": 0}}
        for number, said, problem in (
            (2, b'{"linear":{"x":NaN},"angular":{"z":0}}', "linear.x is nan"),
            (2, b"not even", "is no JSON"),
            (2, b"[1, 2]", "linear.x is missing"),
            (2, b"[" * 50_000, "is no JSON"),
            (3, b"\x00\x01\x00\x00\x07", "is no geometry_msgs/msg/Twist"),
            (1, {"header": old, "pose": PLACE}, "s ahead"),
            (9, {"header": HEADER, "pose": PLACE}, "was not advertised"),
        ):
            client.publish(number, said)
            client.until_warned(problem)
        client.until(lambda: state(client)["counts"] == {"/cmd_vel": 5, "/goal_pose": 1})
        wrong: tuple[tuple[Any, str], ...] = (
            ({"op": "advertise", "channels": [{"id": 5, "topic": "/odom", "encoding": "cdr"}]}, "is no input"),
            (
                {
                    "op": "advertise",
                    "channels": [{"id": 5, "topic": "/cmd_vel", "encoding": "json", "schemaName": "X"}],
                },
                "/cmd_vel is geometry_msgs/msg/Twist",
            ),
            ({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 9999}]}, "no channel 9999"),
            ({"op": "unknown"}, "is not known here"),
            ([1], "a message of no sense"),
        )
        for asked, problem in wrong:
            client.say(asked)
            client.until_warned(problem)
        client.connection.send(b"\x05nonsense")
        client.until(lambda: state(client)["state"] == "arrived")
    assert served.robot.stops_s == []


def test_a_flood_is_sent_away_and_nothing_grows(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.advertise(2, "/cmd_vel", "geometry_msgs/msg/Twist")

        def flood() -> None:
            for _ in range(100_000):
                client.publish(2, velocity(0.3))

        with pytest.raises(ConnectionClosed):
            flood()
    served.until_stands()
    assert any("too many messages" in line for line in served.problems)
    with FoxgloveClient(served.address) as client:
        client.subscribe("/map")
        client.last("/map")


def test_a_client_that_sends_nonsense_again_and_again_is_sent_away(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:

        def annoy() -> None:
            for _ in range(100):
                client.say({"op": "unknown"})
                client.read(0.02)

        with pytest.raises(ConnectionClosed):
            annoy()
    assert any("make no sense" in line for line in served.problems)


@pytest.mark.slow
def test_a_client_that_never_reads_is_sent_away_while_others_are_served() -> None:
    problems, make = list[str](), Messages(is_ros1=False)
    server = FoxgloveServer("0", TOKEN, Inputs(lambda: 0.0), lambda *_: None, problems.append)
    grid = make.bytes_of(make.occupancy(0.0, "map", np.zeros((1000, 1000), np.int8), 0.05, np.eye(4)))
    try:
        with socket.socket() as made, FoxgloveClient(server.address) as client:
            # It opens a websocket by hand, subscribes to the map, and takes nothing.
            made.connect(("127.0.0.1", server.port))
            key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            head = f"GET /?token={TOKEN} HTTP/1.1\r\nHost: a\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n{key}"
            made.sendall(f"{head}Sec-WebSocket-Protocol: {PROTOCOL}\r\n\r\n".encode())
            client.subscribe("/map")
            asked = [{"id": 1, "channelId": client.channels["/map"]["id"]}]
            said = json.dumps({"op": "subscribe", "subscriptions": asked}).encode()
            made.sendall(b"\x81" + bytes([0x80 | len(said)]) + b"\0\0\0\0" + said)  # masked by zeros
            began_s = time.monotonic()
            while not any("never reads" in line for line in problems):
                assert time.monotonic() < began_s + 60
                server.send(TOPICS["/map"], grid, 0)
                client.read(0.05)
            count = len(client.messages["/map"])
            server.send(TOPICS["/map"], grid, 0)
            client.until(lambda: len(client.messages["/map"]) > count)
    finally:
        server.close()


def test_stop_holds_a_stick_until_it_is_released(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.advertise(1, "/wheelsight/stop", "std_msgs/msg/Empty")
        client.advertise(2, "/cmd_vel", "geometry_msgs/msg/Twist")

        def push(forward_m_s: float, is_over: Callable[[float], bool]) -> None:
            began_s = time.monotonic()
            while not is_over(passed_s := time.monotonic() - began_s):
                assert passed_s < 60
                client.publish(2, velocity(forward_m_s))
                time.sleep(0.03)

        push(0.3, lambda passed_s: served.robot.base.forward_m_s > 0.2)
        client.publish(1, {})
        push(0.3, lambda passed_s: bool(served.robot.stops_s) and passed_s > 2)
        assert served.stands
        assert len(served.robot.stops_s) == 1
        push(0.0, lambda passed_s: passed_s > 0.2)
        push(0.3, lambda passed_s: served.robot.base.forward_m_s > 0.2)


def test_a_given_pose_opens_the_map_again_there(served: Linked) -> None:
    with FoxgloveClient(served.address) as client:
        client.advertise(1, "/initialpose", "geometry_msgs/PoseWithCovarianceStamped")
        client.publish(1, {"header": HEADER, "pose": {"pose": PLACE, "covariance": [0] * 36}})
        client.until(lambda: len(served.maps.opened_with) > 1)
    name, pose = served.maps.opened_with[-1]
    assert name == "today"
    assert pose == pytest.approx([5.0, 3.0, 0.0])


@pytest.mark.parametrize("query", ["", "?token=", "?token=0123456789abcdefTOKEM", "?token=x&token=" + TOKEN])
def test_without_the_token_nothing_is_shown(served: Linked, query: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        FoxgloveClient(served.address.split("?")[0] + query)
    assert refused.value.response.status_code == 401
    assert any("no token, or a wrong one" in line for line in served.problems)


def test_there_is_room_for_eight(served: Linked) -> None:
    clients = [FoxgloveClient(served.address) for _ in range(8)]
    for client in clients:
        client.until_reported()
    with pytest.raises(InvalidStatus) as refused:
        FoxgloveClient(served.address)
    assert refused.value.response.status_code == 503
    for client in clients:
        client.__exit__()


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (LinkSettings(foxglove="here"), "--foxglove is 'here' (a port"),
        (LinkSettings(foxglove="99999"), "--foxglove is '99999'"),
        (LinkSettings(foxglove="0", token="short"), "--link-token can be guessed"),
        (LinkSettings(token=TOKEN), "--link-token is of Foxglove's server"),
        (LinkSettings(namespace="/chair"), "--domain, --namespace and --interface are of ROS 2"),
        (LinkSettings(ros2="fast"), "--ros2 is 'fast' (dds or zenoh)"),
        (LinkSettings(ros2="dds", domain=300), "--domain is 300"),
        (LinkSettings(ros2="dds", namespace="chair"), "--namespace is 'chair'"),
    ],
)
def test_options_that_mean_nothing_are_refused(settings: LinkSettings, problem: str) -> None:
    with pytest.raises(ConfigError) as refused:
        settings.check()
    assert str(refused.value).startswith(problem)


def test_a_port_that_is_taken_is_said(served: Linked) -> None:
    port = served.address.split(":")[2].split("/")[0]
    with pytest.raises(ConfigError, match=f"cannot use 127.0.0.1, port {port}"), linked(LinkSettings(foxglove=port)):
        pass


def test_the_sdks_own_server_speaks_alike_and_lets_strangers_in(served: Linked) -> None:
    """The oracle of the protocol; and why it is not used: it asks for no token."""
    foxglove = pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    context = foxglove.Context()
    capabilities = [foxglove.Capability.ClientPublish]
    how = {"capabilities": capabilities, "supported_encodings": ["json", "cdr"], "context": context}
    server = foxglove.start_server(name="theirs", port=0, **how)
    try:
        definition, _ = Messages(is_ros1=False).types.generate_msgdef("std_msgs/msg/String", ros_version=2)
        schema = foxglove.Schema(name="std_msgs/msg/String", encoding="ros2msg", data=definition.encode())
        channel = foxglove.Channel("/said", schema=schema, message_encoding="cdr", context=context)
        address = f"ws://127.0.0.1:{server.port}/?token=wrong"
        with FoxgloveClient(address, origin="https://evil.example") as theirs, FoxgloveClient(served.address) as ours:
            for client in (theirs, ours):
                client.until_reported()
            assert ours.about.keys() <= theirs.about.keys() | {"metadata"}
            assert ours.about["capabilities"] == theirs.about["capabilities"]
            assert set(ours.about["supportedEncodings"]) == set(theirs.about["supportedEncodings"])
            assert ours.connection.subprotocol == theirs.connection.subprotocol
            said = theirs.channels["/said"]
            mine = ours.channels[STATUS]
            assert {**mine, "id": 0, "topic": ""} == {**said, "id": 0, "topic": ""}
            theirs.subscribe("/said")
            make = Messages(is_ros1=False)
            ends_s = time.monotonic() + 20.0
            while not theirs.messages and time.monotonic() < ends_s:
                channel.log(make.bytes_of(make.text("hello")), log_time=7)
                theirs.read(0.05)
            assert theirs.messages["/said"][0][0] == 7
            assert theirs.last("/said").data == "hello"
    finally:
        server.stop()
