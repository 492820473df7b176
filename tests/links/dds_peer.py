"""A program of ROS 2 by Cyclone DDS alone, with types written from ROS's own definitions: it shares nothing with ours.

`python dds_peer.py DOMAIN [NAMESPACE]` reads commands as lines of JSON, and writes what it received as lines of JSON.
"""

# mypy: ignore-errors
# Cyclone's metaclass takes the fields' types at run time, from annotations that mypy takes for wrong.

import json
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
    '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str = "map"


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Point(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64 = 0.0
    y: float64 = 0.0
    z: float64 = 0.0
    w: float64 = 1.0


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Point
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class PoseWithCovarianceStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[int8]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str = ""


@dataclass
class Empty(IdlStruct, typename="std_msgs::msg::dds_::Empty_"):
    structure_needs_at_least_one_member: uint8 = 0


# As RViz and Nav2 subscribe: maps and static transforms transient local, sensors best effort.
RELIABLE, BEST = Policy.Reliability.Reliable(duration(seconds=1)), Policy.Reliability.BestEffort
KEPT = Policy.Durability.TransientLocal
TAKEN = {
    "odom": (Odometry, (RELIABLE,)),
    "map": (OccupancyGrid, (RELIABLE, KEPT)),
    "tf": (TFMessage, (RELIABLE,)),
    "tf_static": (TFMessage, (RELIABLE, KEPT)),
    "scan": (LaserScan, (BEST,)),
    "wheelsight/status": (String, (RELIABLE, KEPT)),
    "wheelsight/pose": (PoseWithCovarianceStamped, (RELIABLE,)),
}
GIVEN = {"cmd_vel": Twist, "goal_pose": PoseStamped, "initialpose": PoseWithCovarianceStamped, "wheelsight/stop": Empty}


def plain(value: Any) -> Any:
    """For JSON, which has no NaN and no infinity."""
    if isinstance(value, list | tuple | bytes):
        return [plain(one) for one in value]
    if isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    return {name: plain(one) for name, one in vars(value).items() if name != "sample_info"}


def message(topic: str, said: dict[str, Any]) -> Any:
    """From short words: v, w; or x, y, z, qw, frame, sec."""
    if topic == "cmd_vel":
        return Twist(Vector3(x=float(said["v"])), Vector3(z=float(said["w"])))
    if topic == "wheelsight/stop":
        return Empty()
    header = Header(Time(said.get("sec", 0)), said.get("frame", "map"))
    pose = Pose(Point(float(said["x"]), float(said["y"])), Quaternion(z=said.get("qz", 0.0), w=said.get("qw", 1.0)))
    return (
        PoseStamped(header, pose)
        if topic == "goal_pose"
        else PoseWithCovarianceStamped(header, PoseWithCovariance(pose, [0.0] * 36))
    )


def say(**said: Any) -> None:
    sys.stdout.write(json.dumps(said) + "\n")
    sys.stdout.flush()


class Program:
    """Takes all topics in one thread, and gives those that flow in another."""

    def __init__(self, domain: int, namespace: str) -> None:
        self._domain, self._participant = Domain(domain, LOOPBACK), DomainParticipant(domain)
        self._prefix, self._flowing = f"rt{namespace}/", {}
        self._readers = {
            name: DataReader(self._participant, self._topic(name, kind), qos=Qos(*qos))
            for name, (kind, qos) in TAKEN.items()
        }
        self._writers = {
            name: DataWriter(self._participant, self._topic(name, kind), qos=Qos(RELIABLE))
            for name, kind in GIVEN.items()
        }
        for work in (self._take, self._flow):
            threading.Thread(target=work, daemon=True).start()

    def _topic(self, name: str, kind: Any) -> Topic:
        return Topic(self._participant, f"{self._prefix}{name}", kind)

    def do(self, said: dict[str, Any]) -> None:
        topic = said["topic"]
        if said.get("every_s") is not None:
            self._flowing[topic] = (said, said["every_s"])
        elif said.get("ends"):
            self._flowing.pop(topic, None)
        else:
            self._writers[topic].write(message(topic, said))

    def _take(self) -> None:
        while True:
            for name, reader in self._readers.items():
                for sample in reader.take(1):
                    if isinstance(sample, TAKEN[name][0]):
                        say(topic=name, message=plain(sample))
            time.sleep(0.005)

    def _flow(self) -> None:
        while True:
            for topic, (said, every_s) in list(self._flowing.items()):
                self._writers[topic].write(message(topic, said))
                time.sleep(every_s)
            time.sleep(0 if self._flowing else 0.01)


if __name__ == "__main__":
    program = Program(int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "")
    say(topic="ready")
    for line in sys.stdin:
        program.do(json.loads(line))
