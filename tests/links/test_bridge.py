"""What a bridge sends of drives and runs, read back by its definitions; and that no peer can stop a robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rehearsed_drive import CALIBRATION, rehearsed_drive
from room_drive import make_room_drive

from wheelsight.app.run.drives import GoalDrive, NamedGoal
from wheelsight.app.run.kernel_process import drawn_room
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.io.recordings import open_recording
from wheelsight.navigation import Feedback
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import TOPICS, Topic
from wheelsight_ros2 import Bridge, Inputs, LiveTopics, RunBridge, Watches

GOAL = NamedGoal.of((-0.7, -0.4), "the middle")
TYPES = Messages(is_ros1=False).types


class Kept:
    """A peer that takes everything."""

    name = "a program"

    def __init__(self, fails_at: str = "") -> None:
        self.messages: dict[str, list[Any]] = {}
        self.fails_at = fails_at

    def wants(self, topic: str) -> bool:
        return True

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        if topic.name == self.fails_at:
            raise OSError("the cable is out")
        self.messages.setdefault(topic.name, []).append(TYPES.deserialize_cdr(data, topic.type))

    def close(self) -> None:
        """Nothing is open."""


def bridge_to(
    *peers: Kept, calibration: Calibration = CALIBRATION, on_problem: Callable[[str], None] = print
) -> Bridge:
    topics = LiveTopics(calibration, lambda topic: True, is_simulated=True)
    return Bridge(peers, topics, Inputs(lambda: 0.0), on_problem)


@pytest.fixture(scope="module")
def driven() -> tuple[Kept, list[Feedback], GoalDrive]:
    kept = Kept()
    bridge = bridge_to(kept)
    drive, _, _ = rehearsed_drive(on_events=bridge.on_events, on_transition=bridge.note)
    steps: list[Feedback] = []

    def step(feedback: Feedback) -> None:
        steps.append(feedback)
        Watches(bridge).step(feedback, drive.navigator)

    assert drive.go_to(GOAL, step)
    return kept, steps, drive


def T_of(transform: Any) -> FloatArray:
    T, q = np.eye(4), transform.rotation
    T[:3, :3] = so3.from_quaternion([q.x, q.y, q.z, q.w])
    T[:3, 3] = transform.translation.x, transform.translation.y, transform.translation.z
    return T


def seconds(header: Any) -> float:
    return float(header.stamp.sec + 1e-9 * header.stamp.nanosec)


def transforms(kept: Kept, topic: str = "/tf") -> dict[tuple[str, str], list[tuple[float, FloatArray]]]:
    found: dict[tuple[str, str], list[tuple[float, FloatArray]]] = {}
    for message in kept.messages[topic]:
        for one in message.transforms:
            key = (one.header.frame_id, one.child_frame_id)
            found.setdefault(key, []).append((seconds(one.header), T_of(one.transform)))
    return found


def test_transforms_compose_to_the_pose_in_the_map(driven: tuple[Kept, list[Feedback], GoalDrive]) -> None:
    kept, steps, _ = driven
    found = transforms(kept)
    known = [one for one in steps if one.pose is not None]
    T_map_odom, T_odom_base = found["map", "odom"], found["odom", "base_link"]
    assert [at_s for at_s, _ in T_map_odom] == pytest.approx([one.stamp_s for one in known])
    poses = dict(T_odom_base)
    for (at_s, T), one in zip(T_map_odom, known, strict=True):
        assert one.pose is not None
        np.testing.assert_allclose(T @ poses[at_s], se3.from_plane(*one.pose), atol=1e-9)
    sent = [one.pose.pose.position for one in kept.messages["/wheelsight/pose"]]
    np.testing.assert_allclose([(p.x, p.y) for p in sent], [one.pose[:2] for one in known if one.pose is not None])
    assert [seconds_of_clock(one) for one in kept.messages["/clock"]] == pytest.approx([one.stamp_s for one in steps])


def seconds_of_clock(message: Any) -> float:
    return float(message.clock.sec + 1e-9 * message.clock.nanosec)


def test_odometry_has_the_speed_of_the_wheels(driven: tuple[Kept, list[Feedback], GoalDrive]) -> None:
    kept, steps, _ = driven
    sent = {seconds(one.header): one.twist.twist for one in kept.messages["/odom"]}
    for one in steps:
        if one.stamp_s in sent:
            assert sent[one.stamp_s].linear.x == one.forward_m_s
            assert sent[one.stamp_s].angular.z == one.turn_rad_s
    assert max(one.linear.x for one in sent.values()) > 0.3


def test_a_scan_lies_on_the_walls_of_the_map(driven: tuple[Kept, list[Feedback], GoalDrive]) -> None:
    """Carried by the transforms alone; the room's walls are its occupied cells."""
    kept, _, _ = driven
    grid = drawn_room()
    rows, columns = np.nonzero(grid.occupancy == 100)
    walls = np.stack([columns + 0.5, rows + 0.5], axis=-1) * grid.resolution_m + np.array(grid.origin[:2])
    found = transforms(kept)
    (_, T_base_scan) = transforms(kept, "/tf_static")["base_link", "camera_scan"][0]
    T_map_odom, T_odom_base = dict(found["map", "odom"]), dict(found["odom", "base_link"])
    off_m, hits = [], 0
    for scan in kept.messages["/scan"]:
        at_s = seconds(scan.header)
        near = [known for known in T_map_odom if abs(known - at_s) < 1e-6]
        if not near:
            continue
        ranges = np.array(scan.ranges)
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        assert angles[-1] == pytest.approx(scan.angle_max)
        is_hit = np.isfinite(ranges)
        hits += int(is_hit.sum())
        p = np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), 0 * angles])[is_hit]
        p = se3.apply(T_map_odom[near[0]] @ T_odom_base[near[0]] @ T_base_scan, p)
        off_m += [float(np.hypot(*(walls - one[:2]).T).min()) for one in p]
    assert hits > 1000
    assert np.quantile(off_m, 0.95) < 0.1


def test_map_plan_images_joints_and_words_are_sent(driven: tuple[Kept, list[Feedback], GoalDrive]) -> None:
    kept, steps, drive = driven
    layer, (grid,) = drive.navigator.senses.floor.layer, kept.messages["/map"]
    assert (grid.info.height, grid.info.width) == layer.state.shape
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == pytest.approx(layer.origin)
    plans = [one.plan for one in steps if one.plan is not None]
    assert len(kept.messages["/plan"]) <= 2 + len({id(plan) for plan in plans})
    sent = next(one for one in kept.messages["/plan"] if len(one.poses))
    p = [(one.pose.position.x, one.pose.position.y) for one in sent.poses]
    np.testing.assert_allclose(p, plans[0].poses[:, :2])
    assert len(kept.messages["/plan"][-1].poses) == 0  # it has arrived
    image = cv2.imdecode(np.array(kept.messages["/camera/color/image_raw/compressed"][0].data), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (240, 320, 3)
    assert len(kept.messages["/joint_states"]) > len(steps)
    costs = np.array(kept.messages["/local_costmap"][-1].data)
    assert costs.max() == 100
    assert ((costs >= -1) & (costs <= 100)).all()
    description = kept.messages["/robot_description"][0].data
    assert all(name in description for name in ("left_wheel_joint", "camera_depth_optical_frame", "base_link"))
    levels = [one.level for one in kept.messages["/diagnostics"][-1].status]
    assert levels == [0, 0, 0]
    assert set(kept.messages) <= {topic.name for topic in TOPICS.values() if topic.is_live}


@pytest.mark.slow
def test_a_peer_that_fails_is_left_out_and_the_others_go_on() -> None:
    bad, good, problems = Kept(fails_at="/odom"), Kept(), list[str]()
    bridge = bridge_to(bad, good, on_problem=problems.append)
    drive, _, _ = rehearsed_drive(on_events=bridge.on_events)
    assert drive.go_to(GOAL, lambda feedback: bridge.step(feedback, drive.navigator))
    assert problems == ["a program is left out: OSError: the cable is out"]
    assert "/odom" not in bad.messages
    assert len(good.messages["/odom"]) > 50


@pytest.mark.slow
def test_messages_that_cannot_be_made_end_the_bridge_and_not_the_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    problems, kept = list[str](), Kept()
    bridge = bridge_to(kept, on_problem=problems.append)
    monkeypatch.setattr(Messages, "odometry", lambda *_: 1 / 0)
    drive, _, _ = rehearsed_drive(on_events=bridge.on_events)
    assert drive.go_to(GOAL, lambda feedback: bridge.step(feedback, drive.navigator))
    (problem,) = problems
    assert problem.startswith("nothing is sent to other programs any more: ZeroDivisionError")


@pytest.mark.slow
@pytest.mark.parametrize("mounted", [True, False])
def test_a_run_is_sent_with_its_poses_and_its_map(tmp_path: Path, *, mounted: bool) -> None:
    make_room_drive(tmp_path / "drive", mounted=mounted, with_truth=False)
    recording = open_recording(tmp_path / "drive")
    odometry = "wheels,dense" if mounted else "dense"
    config = load_config(overrides={"odometry": odometry, "map": "surfels"})
    kept = Kept()
    bridge = bridge_to(kept, calibration=recording.calibration)
    records = run_each(recording, config, tmp_path / "out", watcher=RunBridge(bridge, None))
    record = records[-1]
    child = "base_link" if mounted else "camera_link"
    at = dict(transforms(kept)["odom", child])
    turned = np.eye(4)
    if not mounted:  # camera axes to those of REP 103
        turned[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    expected = record.estimate if record.odom is None else record.odom
    np.testing.assert_allclose([*at], expected.stamps_s, rtol=0, atol=2e-9)  # nanoseconds
    np.testing.assert_allclose([*at.values()], turned @ expected.T_frame_body @ turned.T, atol=1e-9)
    T_map_odom = dict(transforms(kept)["map", "odom"])
    for message in kept.messages["/wheelsight/pose"]:
        p, at_s = message.pose.pose.position, seconds(message.header)
        np.testing.assert_allclose((T_map_odom[at_s] @ at[at_s])[:3, 3], (p.x, p.y, p.z), atol=1e-9)
    points = kept.messages["/map_points"][-1]
    assert points.width * points.height > 1000
    assert len(kept.messages["/clock"]) > 20
    assert kept.messages["/wheelsight/status"]
