"""Drivers of a robot as another program: plays a bag by Cyclone DDS alone; its types are from ROS's definitions.

`python ros2_driver.py DOMAIN BAG [/topic=SECONDS …]` repeats the bag; its headers get the time of now, and topics that
are named the given offset besides.
"""

# mypy: ignore-errors
# Cyclone's metaclass takes the fields' types at run time, from annotations that mypy takes for wrong.

import struct
import sys
import time
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dds_peer import LOOPBACK, Header, Odometry, Quaternion, TFMessage, Vector3, say
from rosbags.highlevel import AnyReader


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class RegionOfInterest(IdlStruct, typename="sensor_msgs::msg::dds_::RegionOfInterest_"):
    x_offset: uint32
    y_offset: uint32
    height: uint32
    width: uint32
    do_rectify: bool


@dataclass
class CameraInfo(IdlStruct, typename="sensor_msgs::msg::dds_::CameraInfo_"):
    header: Header
    height: uint32
    width: uint32
    distortion_model: str
    d: sequence[float64]
    k: array[float64, 9]
    r: array[float64, 9]
    p: array[float64, 12]
    binning_x: uint32
    binning_y: uint32
    roi: RegionOfInterest


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


MOST_IMAGES = 40
KINDS = {f"sensor_msgs/msg/{kind.__name__}": kind for kind in (Image, CameraInfo, JointState, Imu)}
KINDS |= {"nav_msgs/msg/Odometry": Odometry, "tf2_msgs/msg/TFMessage": TFMessage, "tf/msg/tfMessage": TFMessage}


def filled(kind, value):
    """A message of ours with the fields of one of a bag."""
    if not isinstance(kind, type) or not issubclass(kind, IdlStruct):
        inner = getattr(kind, "__metadata__", (None,))[0]
        of = getattr(inner, "subtype", None)
        if isinstance(of, type) and issubclass(of, IdlStruct):
            return [filled(of, one) for one in value]
        if isinstance(value, np.ndarray):
            return value.tobytes() if value.dtype == np.uint8 else value.tolist()
        return value
    hints = kind.__annotations__
    found = {}
    for one in fields(kind):
        name = one.name if hasattr(value, one.name) else one.name.upper()  # ROS 1 writes D, K, R, P
        found[one.name] = filled(hints[one.name], getattr(value, name))
    return kind(**found)


def play(domain: int, path: Path, shifts: dict[str, float]) -> None:
    network, participant = Domain(domain, LOOPBACK), DomainParticipant(domain)
    reliable = Policy.Reliability.Reliable(duration(infinite=True))  # as rmw_cyclonedds
    with AnyReader([path]) as reader:
        taken = [one for one in reader.connections if one.msgtype in KINDS]
        messages, images = [], 0
        for one, at_ns, data in reader.messages(taken):
            images += one.topic.endswith("color/image_raw")
            if images > MOST_IMAGES:  # serializing them in Python takes long
                break
            messages.append((at_ns, one.topic, filled(KINDS[one.msgtype], reader.deserialize(data, one.msgtype))))
    writers = {}
    for one in taken:
        kept = [Policy.Durability.TransientLocal] if one.topic == "/tf_static" else []
        qos = Qos(reliable if kept or one.topic != "/imu/data" else Policy.Reliability.BestEffort, *kept)
        topic = Topic(participant, f"rt{one.topic}", KINDS[one.msgtype])
        writers[one.topic] = DataWriter(participant, topic, qos=qos)
    # The stamp of a header is the first of a message: each is serialized once, and gets its stamp there.
    encoded = {id(one): bytearray(one.serialize()) for _, _, one in messages if not isinstance(one, TFMessage)}
    for kind in {type(one) for _, _, one in messages} - {TFMessage}:
        kind.serialize = lambda self, *_, **__: bytes(encoded[id(self)])
    begins_ns, ends_ns = messages[0][0], messages[-1][0]
    say(topic="ready", message=sorted(writers))
    while network is not None:
        began_ns, before_ns = time.time_ns(), begins_ns
        for at_ns, topic, message in messages:
            late_ns = time.time_ns() - (began_ns + at_ns - begins_ns)
            if at_ns != before_ns and late_ns > 50_000_000:  # a busy computer: the clock waits
                began_ns += late_ns
            before_ns, due_ns = at_ns, began_ns + at_ns - begins_ns
            time.sleep(max(due_ns - time.time_ns(), 0) * 1e-9)
            stamp = divmod(due_ns + round(1e9 * shifts.get(topic, 0.0)), 10**9)
            if isinstance(message, TFMessage):
                for part in message.transforms:
                    part.header.stamp.sec, part.header.stamp.nanosec = stamp
            else:
                encoded[id(message)][4:12] = struct.pack("<iI", *stamp)
            writers[topic].write(message)
        time.sleep(max(began_ns + ends_ns - begins_ns + 50_000_000 - time.time_ns(), 0) * 1e-9)


if __name__ == "__main__":
    play(
        int(sys.argv[1]),
        Path(sys.argv[2]),
        {one.partition("=")[0]: float(one.partition("=")[2]) for one in sys.argv[3:]},
    )
