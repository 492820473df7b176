"""Topics of bags, ROS 2 and Foxglove: each name, type and quality of service, stated once. `TOPICS` is the list."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from wheelsight.io.recordings.bags.topics import CALIBRATION, WHEEL_ODOMETRY

MAP, ODOM, BASE, LINK, SCAN_FRAME = "map", "odom", "base_link", "camera_link", "camera_scan"
COLOR_FRAME, DEPTH_FRAME = "camera_color_optical_frame", "camera_depth_optical_frame"
TF, TF_STATIC, JOINT_STATES, IMU = "/tf", "/tf_static", "/joint_states", "/imu/data"
COLOR, DEPTH, REGISTERED = "/camera/color", "/camera/depth", "/camera/aligned_depth_to_color"
ODOM_TOPIC, DIAGNOSTICS_TOPIC, MAP_TOPIC, POINTS_TOPIC = "/odom", "/diagnostics", "/map", "/map_points"
WAY_TOPIC, TRUTH_TOPIC = "/trajectory", "/ground_truth"
POSE_TOPIC, STATUS_TOPIC, COSTMAP_TOPIC = "/wheelsight/pose", "/wheelsight/status", "/local_costmap"
PLAN_TOPIC, SCAN_TOPIC, CLOCK_TOPIC, MARKERS_TOPIC = "/plan", "/scan", "/clock", "/wheelsight/markers"
ROBOT_TOPIC = "/robot_description"
VELOCITY_TOPIC, GOAL_TOPIC, CLICKED_TOPIC = "/cmd_vel", "/goal_pose", "/clicked_point"
INITIAL_TOPIC, STOP_TOPIC = "/initialpose", "/wheelsight/stop"
# Of ROS 2 over DDS alone: an action, which is three services and two topics; and the nodes of each participant.
NAVIGATE_ACTION, NODES_TOPIC = "/navigate_to_pose", "ros_discovery_info"


class Flow(Enum):
    """Quality of service of a topic, and its direction."""

    SENSOR = "best effort, the last message"
    RELIABLE = "reliable, the last ten messages"
    LATCHED = "reliable and transient local, the last message"
    INPUT = "received: reliable, the last message"
    COMMAND = "received: best effort, the last message"


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic.

    Attributes:
        name: without a namespace.
        type: as ROS names it, such as nav_msgs/msg/Odometry.
        flow: quality of service and direction.
        is_live: whether live interfaces have it; else only bags do.
    """

    name: str
    type: str
    flow: Flow
    is_live: bool = True


def _images(prefix: str, transport: str) -> tuple[Topic, ...]:
    return (
        Topic(f"{prefix}/camera_info", "sensor_msgs/msg/CameraInfo", Flow.SENSOR),
        Topic(f"{prefix}/image_raw", "sensor_msgs/msg/Image", Flow.SENSOR, is_live=False),
        Topic(f"{prefix}/image_raw/{transport}", "sensor_msgs/msg/CompressedImage", Flow.SENSOR),
    )


TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        Topic(TF, "tf2_msgs/msg/TFMessage", Flow.RELIABLE),
        Topic(TF_STATIC, "tf2_msgs/msg/TFMessage", Flow.LATCHED),
        Topic(CLOCK_TOPIC, "rosgraph_msgs/msg/Clock", Flow.SENSOR),
        Topic(ODOM_TOPIC, "nav_msgs/msg/Odometry", Flow.RELIABLE),
        Topic(POSE_TOPIC, "geometry_msgs/msg/PoseWithCovarianceStamped", Flow.RELIABLE),
        Topic(STATUS_TOPIC, "std_msgs/msg/String", Flow.LATCHED),
        Topic(DIAGNOSTICS_TOPIC, "diagnostic_msgs/msg/DiagnosticArray", Flow.RELIABLE),
        Topic(MAP_TOPIC, "nav_msgs/msg/OccupancyGrid", Flow.LATCHED),
        Topic(COSTMAP_TOPIC, "nav_msgs/msg/OccupancyGrid", Flow.LATCHED),
        Topic(PLAN_TOPIC, "nav_msgs/msg/Path", Flow.LATCHED),
        Topic(SCAN_TOPIC, "sensor_msgs/msg/LaserScan", Flow.SENSOR),
        Topic(MARKERS_TOPIC, "visualization_msgs/msg/MarkerArray", Flow.RELIABLE),
        Topic(JOINT_STATES, "sensor_msgs/msg/JointState", Flow.RELIABLE),
        Topic(IMU, "sensor_msgs/msg/Imu", Flow.SENSOR),
        Topic(WHEEL_ODOMETRY, "nav_msgs/msg/Odometry", Flow.RELIABLE),
        Topic(CALIBRATION, "std_msgs/msg/String", Flow.LATCHED),
        Topic(ROBOT_TOPIC, "std_msgs/msg/String", Flow.LATCHED),
        *_images(COLOR, "compressed"),
        *_images(DEPTH, "compressedDepth"),
        *_images(REGISTERED, "compressedDepth"),
        Topic(POINTS_TOPIC, "sensor_msgs/msg/PointCloud2", Flow.LATCHED),
        Topic(WAY_TOPIC, "nav_msgs/msg/Path", Flow.LATCHED, is_live=False),
        Topic(TRUTH_TOPIC, "nav_msgs/msg/Path", Flow.LATCHED, is_live=False),
        Topic(VELOCITY_TOPIC, "geometry_msgs/msg/Twist", Flow.COMMAND),
        Topic(GOAL_TOPIC, "geometry_msgs/msg/PoseStamped", Flow.INPUT),
        Topic(INITIAL_TOPIC, "geometry_msgs/msg/PoseWithCovarianceStamped", Flow.INPUT),
        Topic(CLICKED_TOPIC, "geometry_msgs/msg/PointStamped", Flow.INPUT),
        Topic(STOP_TOPIC, "std_msgs/msg/Empty", Flow.INPUT),
    )
}
"""All topics by their names."""
