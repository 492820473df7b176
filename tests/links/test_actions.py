"""A client in another process, with types of its own, sends the robot to poses by the action NavigateToPose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from links.bridged import Linked, linked
from links.test_dds import DdsProgram, program

from wheelsight_ros2 import LinkSettings

pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
DOMAIN = 87
ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = 1, 2, 3, 4, 5, 6


@contextmanager
def clients(domain: int, namespace: str = "") -> Iterator[tuple[Linked, DdsProgram]]:
    settings = LinkSettings(ros2="dds", domain=domain, namespace=namespace)
    with linked(settings) as served, program(domain, namespace, "action_client.py") as client:
        yield served, client


def answered(client: DdsProgram, topic: str, number: int) -> dict[str, Any]:
    """The response to a request, by its number."""
    found: Callable[[], list[Any]] = lambda: [  # noqa: E731
        one for one in client.received.get(topic, []) if one["number"] == number
    ]
    return dict(client.until(found)[0])


def status(client: DdsProgram, id_: int) -> int | None:
    """The last status of a goal."""
    rows = client.received.get("status", [{"status_list": []}])[-1]["status_list"]
    return next((row["status"] for row in rows if row["goal_info"]["goal_id"]["uuid"] == [id_] * 16), None)


@pytest.mark.slow
def test_a_goal_is_driven_to_with_feedback_and_a_result() -> None:
    with clients(DOMAIN, "/chair") as (served, client):
        client.say("send", id=1, x=5.0, y=3.0)
        assert answered(client, "send", 1)["accepted"]
        client.say("result", id=1)
        client.until(lambda: status(client, 1) == EXECUTING)
        client.until(lambda: len(client.received.get("feedback", [])) > 5)
        assert "result" not in client.received
        answer = answered(client, "result", 2)
        assert (answer["status"], answer["result"]) == (SUCCEEDED, {"error_code": 0, "error_msg": ""})
        assert served.robot.base.pose[:2] == pytest.approx((5.0, 3.0), abs=0.2)
        client.until(lambda: status(client, 1) == SUCCEEDED)
        said = [one["feedback"] for one in client.received["feedback"]]
        assert all(one["goal_id"]["uuid"] == [1] * 16 for one in client.received["feedback"])
        left = [one["distance_remaining"] for one in said]
        assert left[0] == pytest.approx(3.5, abs=0.4)
        assert left[-1] < 0.6
        x = [one["current_pose"]["pose"]["position"]["x"] for one in said]
        assert x[0] < 2
        assert x[-1] > 4.3
        times = [one["navigation_time"]["sec"] + 1e-9 * one["navigation_time"]["nanosec"] for one in said]
        assert times == sorted(times)
        # A result is kept; an unknown goal has none.
        client.say("result", id=1)
        assert answered(client, "result", 3)["status"] == SUCCEEDED
        client.say("result", id=9)
        assert answered(client, "result", 4)["status"] == 0
        assert served.problems == []


@pytest.mark.slow
def test_a_goal_is_cancelled_and_the_robot_stands() -> None:
    with clients(DOMAIN + 1) as (served, client):
        client.say("send", id=1, x=6.5, y=3.0)
        client.say("result", id=1)
        client.until(lambda: client.received.get("feedback") and served.robot.base.forward_m_s > 0.2)
        client.say("cancel", id=1)
        answer = answered(client, "cancel", 3)
        assert answer["return_code"] == 0
        assert [one["goal_id"]["uuid"] for one in answer["goals_canceling"]] == [[1] * 16]
        assert answered(client, "result", 2)["status"] == CANCELED
        served.until_stands()
        assert served.robot.base.pose[0] < 6.0
        assert not served.session.switch.reason, "a cancelled goal is no stop"
        for id_, code in ((1, 3), (7, 2), (0, 1)):  # terminated, unknown, and nothing to cancel
            client.say("cancel", id=id_)
            assert answered(client, "cancel", client.said)["return_code"] == code
        client.say("send", id=2, x=1.5, y=3.0, qw=1.0)
        client.until(lambda: status(client, 2) == EXECUTING)
        client.say("cancel", id=0)  # all
        assert answered(client, "cancel", client.said)["return_code"] == 0
        client.until(lambda: status(client, 2) == CANCELED)
        assert served.problems == []


@pytest.mark.slow
def test_a_second_goal_replaces_the_first_and_stop_aborts() -> None:
    with clients(DOMAIN + 2) as (served, client):
        client.say("send", id=1, x=6.5, y=3.0)
        client.say("result", id=1)
        client.until(lambda: served.robot.base.forward_m_s > 0.2)
        client.say("send", id=2, x=3.0, y=4.0)
        client.say("result", id=2)
        first = answered(client, "result", 2)
        assert first["status"] == ABORTED
        assert "another task" in first["result"]["error_msg"]
        assert answered(client, "result", 4)["status"] == SUCCEEDED
        assert served.robot.base.pose[:2] == pytest.approx((3.0, 4.0), abs=0.2)
        client.say("send", id=3, x=6.5, y=3.0)
        client.say("result", id=3)
        client.until(lambda: status(client, 3) == EXECUTING)
        served.session.stop("a person pressed stop")
        third = answered(client, "result", 6)
        assert third["status"] == ABORTED
        assert "canceled" in third["result"]["error_msg"]
        assert third["result"]["error_code"] != 0


@pytest.mark.slow
def test_a_goal_that_is_none_is_not_accepted() -> None:
    with clients(DOMAIN + 3) as (served, client):
        wrong: list[dict[str, Any]] = [{"x": "nan"}, {"x": 1.0, "frame": "odom"}, {"x": 1.0, "qw": 0.0}]
        for number, said in enumerate(wrong, 1):
            client.say("send", id=number, y=1.0, **said)
            assert not answered(client, "send", number)["accepted"]
        assert served.bridge is not None
        assert served.bridge.inputs.counts == {"/navigate_to_pose": 3}
        client.say("send", id=9, x=3.0, y=3.0)
        assert answered(client, "send", 4)["accepted"]
        client.say("send", id=9, x=3.0, y=3.0)
        assert not answered(client, "send", 5)["accepted"], "one id for two goals"
        assert "was used before" in served.bridge.inputs.refused


@pytest.mark.slow
def test_the_node_is_announced_with_its_ends() -> None:
    with clients(DOMAIN + 4, "/chair") as (_, client):
        client.say("result", id=5)
        answered(client, "result", 1)
        client.say("nodes")
        info = client.last("nodes")
        (node,) = info["node_entities_info_seq"]
        assert (node["node_namespace"], node["node_name"]) == ("/chair", "wheelsight")
        named = {kind: [one["data"] for one in node[f"{kind}_gid_seq"]] for kind in ("reader", "writer")}
        assert info["readers"]
        assert info["writers"]
        assert all(key in named["reader"] for key in info["readers"])
        assert all(key in named["writer"] for key in info["writers"])
        assert len(named["writer"]) > 20
