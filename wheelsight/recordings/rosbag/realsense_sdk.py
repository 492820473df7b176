"""What is particular about bags that the RealSense SDK records, in which it keeps more than ROS's messages hold.

A stream's topics begin with its name, such as /device_0/sensor_1/Color_0: image/data, info/camera_info, and tf/0, the
transform into its frame from that of a group of streams, here group 0. Of newer versions an image whose frame is called
"1" has four more bytes: how many metres a unit of depth is.
"""

from __future__ import annotations

import re
import struct

from wheelsight.geometry import FloatArray, se3
from wheelsight.recordings.rosbag.storage import OpenBag
from wheelsight.recordings.rosbag.transforms import motion_of

_IMAGE = re.compile(r"(/device_\d+/sensor_\d+/\w+_\d+)/image/data")
_TRANSFORM = "geometry_msgs/msg/Transform"
# Metres a unit: from a tenth of a micrometre to a metre; others are damaged.
_LEAST_UNIT_M, _LARGEST_UNIT_M = 1e-7, 1.0


def depth_units_m(bag: OpenBag, topic: str) -> float | None:
    """Metres a unit of depth, as a topic's first image says; None where it is not the SDK's, or says nothing."""
    if not (bag.is_ros1 and _IMAGE.fullmatch(topic)):
        return None
    data = bag.first(topic)[0].data
    units_m = float(struct.unpack("<f", data[-4:])[0]) if bag.has_units(topic, data) else 0.0
    return units_m if _LEAST_UNIT_M <= units_m <= _LARGEST_UNIT_M else None


def joined(bag: OpenBag, color: str, depth: str) -> FloatArray | None:
    """T_color_depth (4, 4) of two image topics; None where they are none of the SDK's, or it kept no transforms."""
    into: list[dict[str, FloatArray]] = []
    for name in (color, depth):
        stream = _IMAGE.fullmatch(name)
        if stream is None:
            return None
        begin, found = f"{stream[1]}/tf/", {}
        for topic in bag.topics:
            if topic.name.startswith(begin) and topic.type == _TRANSFORM and topic.count:
                message = bag.decode(bag.first(topic.name)[0])
                T_stream_group = motion_of(message.translation, message.rotation)
                if T_stream_group is not None:
                    found[topic.name.removeprefix(begin)] = T_stream_group
        into.append(found)
    groups = sorted(into[0].keys() & into[1].keys())
    return se3.compose(into[0][groups[0]], se3.invert(into[1][groups[0]])) if groups else None
