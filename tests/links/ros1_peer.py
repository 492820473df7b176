"""A node of ROS 1 by rospy, which Debian's Python runs: `ros1_peer.py listen SECONDS` prints poses of /odom and cells
of /map as JSON; `ros1_peer.py drive SECONDS` publishes /odom of a circle at 50 Hz.
"""

# mypy: ignore-errors
# rospy is a package of Debian's Python alone.

import json
import math
import sys
import threading
import time

import rospy
from nav_msgs.msg import OccupancyGrid, Odometry
from tf2_msgs.msg import TFMessage

SPEED_M_S, TURN_RAD_S = 0.4, 0.5


def listen(seconds: float) -> None:
    found, lock = {"odom": [], "map": [], "tf": []}, threading.Lock()

    def note(name, value):
        with lock:
            found[name].append(value)

    def odom(message):
        p = message.pose.pose.position
        note("odom", [message.header.stamp.to_sec(), p.x, p.y, message.header.frame_id, message.child_frame_id])

    rospy.Subscriber("/odom", Odometry, odom)
    rospy.Subscriber("/map", OccupancyGrid, lambda one: note("map", [one.info.width, one.info.height, sum(one.data)]))
    rospy.Subscriber("/tf", TFMessage, lambda one: note("tf", [part.child_frame_id for part in one.transforms]))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    time.sleep(seconds)
    with lock:
        sys.stdout.write(json.dumps(found) + "\n")


def drive(seconds: float) -> None:
    publisher = rospy.Publisher("/odom", Odometry, queue_size=10)
    while publisher.get_num_connections() == 0:
        time.sleep(0.02)
    begin_s = time.time()
    while (now_s := time.time()) < begin_s + seconds:
        message, angle = Odometry(), TURN_RAD_S * (now_s - begin_s)
        message.header.stamp, message.header.frame_id = rospy.Time.from_sec(now_s), "odom"
        message.child_frame_id = "base_link"
        pose, radius_m = message.pose.pose, SPEED_M_S / TURN_RAD_S
        pose.position.x, pose.position.y = radius_m * math.sin(angle), radius_m * (1 - math.cos(angle))
        pose.orientation.z, pose.orientation.w = math.sin(angle / 2), math.cos(angle / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = SPEED_M_S, TURN_RAD_S
        publisher.publish(message)
        time.sleep(0.02)


if __name__ == "__main__":
    rospy.init_node("peer", anonymous=True, disable_signals=True)
    {"listen": listen, "drive": drive}[sys.argv[1]](float(sys.argv[2]))
