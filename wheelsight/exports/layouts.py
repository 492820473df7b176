"""Layouts that show an exported bag: a file for Foxglove and one for RViz, with the topics that the bag has.

Foxglove's is what its "Import from file" takes (panels by id, and how they share the window); RViz's is its own
configuration, of RViz 2 for bags of ROS 2 and of RViz 1 for bags of ROS 1, whose classes have other names.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import yaml

from wheelsight.files import write_text

ODOM_TOPIC, DIAGNOSTICS_TOPIC, MAP_TOPIC, POINTS_TOPIC = "/odom", "/diagnostics", "/map", "/map_points"
WAY_TOPIC, TRUTH_TOPIC = "/trajectory", "/ground_truth"
_WAYS = {WAY_TOPIC: (0, 114, 178), TRUTH_TOPIC: (0, 158, 115)}  # red, green, blue (Okabe & Ito 2008)
_COLOR_IMAGES = ("/camera/color/image_raw", "/camera/color/image_raw/compressed")
_LINE_M = 0.04
_POINT_PX = 3


def layout_paths(bag: Path) -> tuple[Path, Path]:
    """Where the layouts of a bag lie, beside it: Foxglove's and RViz's."""
    return bag.with_suffix(".foxglove.json"), bag.with_suffix(".rviz")


def write_layouts(bag: Path, topics: Collection[str], fixed_frame: str) -> tuple[Path, Path]:
    """Write both; where they lie. Raises OutputError."""
    paths = layout_paths(bag)
    write_text(paths[0], json.dumps(foxglove_layout(topics, fixed_frame), indent=2) + "\n")
    text = yaml.safe_dump(rviz_config(topics, fixed_frame, is_ros1=bag.suffix == ".bag"), sort_keys=False)
    write_text(paths[1], text)
    return paths


def foxglove_layout(topics: Collection[str], fixed_frame: str) -> dict[str, Any]:
    """3D with map, points and ways; beside it image, speed and diagnostics, as far as the bag has them."""
    shown: dict[str, Any] = {topic: {"visible": True} for topic in (MAP_TOPIC, ODOM_TOPIC) if topic in topics}
    if POINTS_TOPIC in topics:
        look = {"colorField": "rgb", "colorMode": "rgb", "pointSize": _POINT_PX, "pointShape": "square"}
        shown[POINTS_TOPIC] = {"visible": True, **look}
    for topic, (red, green, blue) in _WAYS.items():
        if topic in topics:
            gradient = [f"#{red:02x}{green:02x}{blue:02x}"] * 2
            shown[topic] = {"visible": True, "type": "line", "lineWidth": _LINE_M, "gradient": gradient}
    grid = {"instanceId": "grid", "layerId": "foxglove.Grid", "label": "Grid", "visible": True, "frameLocked": True}
    panels: dict[str, Any] = {
        "3D!wheelsight": {
            "followMode": "follow-none",
            "followTf": fixed_frame,
            "topics": shown,
            "layers": {"grid": {**grid, "size": 20, "divisions": 20, "lineWidth": 1, "color": "#b0b0b0"}},
            "cameraState": {"perspective": False, "distance": 20, "phi": 0, "thetaOffset": 0, "target": [0, 0, 0]},
        }
    }
    beside: list[str] = []
    if image := _image_of(topics):
        panels["Image!wheelsight"] = {"imageMode": {"imageTopic": image}}
        beside.append("Image!wheelsight")
    if ODOM_TOPIC in topics:
        speeds = ({"value": f"{ODOM_TOPIC}.twist.twist.{axis}"} for axis in ("linear.x", "angular.z"))
        paths = [{**speed, "enabled": True, "timestampMethod": "headerStamp"} for speed in speeds]
        panels["Plot!wheelsight"] = {"title": "speed, m/s, and turn, rad/s", "paths": paths, "isSynced": True}
        beside.append("Plot!wheelsight")
    if DIAGNOSTICS_TOPIC in topics:
        panels["DiagnosticSummary!wheelsight"] = {"topicToRender": DIAGNOSTICS_TOPIC, "minLevel": 0}
        beside.append("DiagnosticSummary!wheelsight")
    tree: Any = "3D!wheelsight"
    if beside:
        tree = {"first": tree, "second": _stacked(beside), "direction": "row", "splitPercentage": 68}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": tree,
    }


def _stacked(panels: list[str]) -> Any:
    """One above the other, each as high."""
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels)
    return {"first": panels[0], "second": _stacked(panels[1:]), "direction": "column", "splitPercentage": share}


def rviz_config(topics: Collection[str], fixed_frame: str, *, is_ros1: bool) -> dict[str, Any]:
    """Displays of map, points, ways, odometry, transforms and image, as far as the bag has them, seen from above."""
    plugin, panel = ("rviz", "rviz") if is_ros1 else ("rviz_default_plugins", "rviz_common")

    def display(
        kind: str, name: str, look: dict[str, Any], topic: str = "", *, is_latched: bool = False
    ) -> dict[str, Any]:
        made = {"Class": f"{plugin}/{kind}", "Name": name, "Enabled": True, "Value": True, **look}
        if topic and is_ros1:
            made["Topic"] = topic
        elif topic:
            durability = "Transient Local" if is_latched else "Volatile"
            reliable = {"Reliability Policy": "Reliable", "History Policy": "Keep Last", "Depth": 10}
            made["Topic"] = {"Value": topic, "Durability Policy": durability, **reliable}
        return made

    shown = [display("Grid", "Grid", {"Reference Frame": "<Fixed Frame>", "Plane Cell Count": 20})]
    shown.append(display("TF", "Transforms", {"Show Names": False}))
    if MAP_TOPIC in topics:
        shown.append(display("Map", "Floor", {"Color Scheme": "map", "Draw Behind": True}, MAP_TOPIC, is_latched=True))
    if POINTS_TOPIC in topics:
        look = {"Color Transformer": "RGB8", "Style": "Points", "Size (Pixels)": _POINT_PX}
        shown.append(display("PointCloud2", "Points of the map", look, POINTS_TOPIC, is_latched=True))
    for topic, colour in _WAYS.items():
        if topic in topics:
            look = {"Color": "; ".join(map(str, colour)), "Line Style": "Billboards", "Line Width": _LINE_M}
            shown.append(display("Path", topic.strip("/").replace("_", " "), look, topic, is_latched=True))
    if ODOM_TOPIC in topics:
        shown.append(display("Odometry", "Odometry", {"Keep": 1}, ODOM_TOPIC))
    if image := _image_of(topics):
        shown.append(_rviz_image(display("Image", "Camera", {}, image), image, is_ros1=is_ros1))
    return {
        "Panels": [{"Class": f"{panel}/Displays", "Name": "Displays"}, {"Class": f"{panel}/Time", "Name": "Time"}],
        "Visualization Manager": {
            "Class": "",
            "Enabled": True,
            "Global Options": {"Fixed Frame": fixed_frame, "Background Color": "48; 48; 48", "Frame Rate": 30},
            "Displays": shown,
            "Views": {"Current": {"Class": f"{plugin}/TopDownOrtho", "Name": "Current View", "Scale": 50}},
        },
    }


def _rviz_image(made: dict[str, Any], topic: str, *, is_ros1: bool) -> dict[str, Any]:
    """RViz 1 has another field for it, and names a compressed image by its raw topic and a transport."""
    if is_ros1:
        del made["Topic"]
        raw, _, transport = topic.partition("/image_raw")
        made |= {"Image Topic": f"{raw}/image_raw", "Transport Hint": transport.strip("/") or "raw"}
    return made


def _image_of(topics: Collection[str]) -> str | None:
    return next((topic for topic in _COLOR_IMAGES if topic in topics), None)
