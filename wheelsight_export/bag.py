"""Writes a run, a map or a recording as a bag for Foxglove, RViz and Nav2, and layouts that show it there."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from wheelsight.core.errors import InputError, OutputError
from wheelsight.core.files import StrPath, write_text
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import express_for
from wheelsight.io.ros_map import read_ros_map
from wheelsight.slam.maps.folder import OCCUPANCY_FILE
from wheelsight_export.bag_writing import Diagnosis, ImageForm, Messages, RobotTopics, Sent, new_bag
from wheelsight_export.sources import (
    Exported,
    body_frame,
    in_odom,
    map_to_odom,
    points_of,
    pose_covariances,
    twists,
    upright,
    upright_points,
)
from wheelsight_export.topics import (
    CLICKED_TOPIC,
    COLOR,
    COSTMAP_TOPIC,
    DIAGNOSTICS_TOPIC,
    GOAL_TOPIC,
    INITIAL_TOPIC,
    MAP,
    MAP_TOPIC,
    MARKERS_TOPIC,
    ODOM,
    ODOM_TOPIC,
    PLAN_TOPIC,
    POINTS_TOPIC,
    POSE_TOPIC,
    SCAN_TOPIC,
    STOP_TOPIC,
    TF,
    TRUTH_TOPIC,
    VELOCITY_TOPIC,
    WAY_TOPIC,
)

DEFAULT_VOXEL_M = 0.05
# The diagnostic level of each status.
_LEVELS = {"tracking": 0, "coasting": 1, "initializing": 1, "failing": 2, "lost": 2}
_ERROR = 2
_TELL_EVERY = 50


@dataclass(frozen=True, slots=True)
class BagParts:
    """The contents of a bag.

    Attributes:
        images: encoding of camera images, or None for none; see `RobotTopics`.
        voxel_m: size of voxels with one map point each.
    """

    images: ImageForm | None = None
    voxel_m: float = DEFAULT_VOXEL_M


@dataclass(frozen=True, slots=True)
class BagReport:
    """The contents of a written bag.

    Attributes:
        topics: number of messages of each.
        size_bytes: of the file.
        warnings: one sentence on each missing part.
        layouts: layout files beside the bag, for Foxglove and RViz.
    """

    topics: dict[str, int]
    size_bytes: int
    warnings: tuple[str, ...]
    layouts: tuple[StrPath, ...]


def export_bag(
    source: Exported,
    path: StrPath,
    parts: BagParts | None = None,
    on_message: Callable[[int], None] = lambda done: None,
) -> BagReport:
    """Write a bag, of ROS 2 for a name in .mcap and of ROS 1 for .bag; and layouts that show it.

    Args:
        source: to export.
        path: of the file, which appears when it is complete.
        parts: its contents.
        on_message: called from time to time with the number of messages.

    Raises:
        ConfigError: another suffix, or rosbags is not installed.
        InputError: the source cannot be read, or is empty.
        OutputError: the file cannot be written, or the disk is full.
    """
    path, parts = Path(path), parts or BagParts()
    counts: dict[str, int] = {}
    with new_bag(path) as bag:
        writing = _Writing(source, parts, bag.make)
        for sent in writing.messages():
            bag.add(sent.topic, sent.message, sent.stamp_s, is_latched=sent.is_latched)
            counts[sent.topic] = counts.get(sent.topic, 0) + 1
            if bag.count % _TELL_EVERY == 0:
                on_message(bag.count)
        if not counts:
            raise OutputError(
                "would be empty: there is nothing to write", path=path, fix="give a run, a map or a recording"
            )
    layouts = write_layouts(path, counts, writing.fixed)
    return BagReport(counts, path.stat().st_size, tuple(writing.warnings), layouts)


class _Writing:
    """The messages of one bag, in order of time, and warnings about missing parts."""

    def __init__(self, source: Exported, parts: BagParts, make: Messages) -> None:
        self.source, self.parts, self.make = source, parts, make
        self.warnings: list[str] = []
        lived, self.calibration = source.trajectory, source.calibration
        has_base = self.calibration is not None and self.calibration.T_base_camera is not None
        is_of_base = has_base or (self.calibration is not None and self.calibration.color is None)
        self.body = lived.body if lived is not None else "base" if is_of_base else "camera"
        self.robot = RobotTopics(make, self.calibration, parts.images)
        # Without a map, map and odom begin together. In a map that is never recognised, map to odom is unknown.
        is_lost = lived is not None and lived.frame == ODOM and source.corrected is None and source.map is not None
        self.fixed = ODOM if is_lost else MAP
        if is_lost:
            self.warnings.append("Nothing leads from map to odom: where the run lies in its map is not known.")

    def messages(self) -> Iterator[Sent]:
        """All messages: latched ones first, with the stamp of the first of the others."""
        streams = (self._poses(), self._statuses(), self._events())
        merged = heapq.merge(*streams, key=lambda sent: sent.stamp_s)
        first = next(merged, None)
        keyframes = {} if self.source.map is None else self.source.map.contents.places
        begin_s = min((place.stamp_s for place in keyframes.values()), default=0.0)
        begin_s = begin_s if first is None else first.stamp_s
        yield from self.robot.mounts(begin_s)
        for topic, way in self._ways():
            path = self.make.path(begin_s, self.fixed, way.stamps_s, way.T_frame_body)
            yield Sent(begin_s, topic, path, is_latched=True)
        points = points_of(self.source, self.parts.voxel_m)
        if points is not None:
            p = upright_points(points.p_map, self.body)
            yield Sent(begin_s, POINTS_TOPIC, self.make.points(begin_s, MAP, p, points.colors), is_latched=True)
        folder = self.source.map
        if folder is not None:
            if not (folder.path / OCCUPANCY_FILE).is_file():
                self.warnings.append("There is no /map: what is free of the floor is not known of this map.")
            else:
                grid = read_ros_map(folder.path / OCCUPANCY_FILE)
                about = (grid.occupancy, grid.resolution_m, se3.from_plane(*grid.origin))
                yield Sent(begin_s, MAP_TOPIC, self.make.occupancy(begin_s, MAP, *about), is_latched=True)
        yield from chain([] if first is None else [first], merged)

    def _ways(self) -> Iterator[tuple[str, Trajectory]]:
        """The final path; of a map, the path through keyframes; and the true path of a recording."""
        lived = self.source.trajectory
        if lived is not None:
            way = self.source.corrected or (lived if self.fixed == MAP else in_odom(lived, self.source.odom))
            yield WAY_TOPIC, upright(way)
        elif self.source.map is not None:
            folder = self.source.need_map()
            stamped = sorted((folder.contents.places[number].stamp_s, number) for number in folder.store)
            T_map_camera = folder.store.T_map_keyframe[[number for _, number in stamped]]
            stamps_s = np.array([stamp_s for stamp_s, _ in stamped])
            keeps = np.diff(stamps_s, prepend=-np.inf) > 0  # drives of before may have been stamped from 0 too
            way = Trajectory(stamps_s[keeps], T_map_camera[keeps])
            yield WAY_TOPIC, upright(express_for(self.body, way, folder.calibration))
        elif self.source.recording is not None and self.source.recording.ground_truth is not None:
            yield TRUTH_TOPIC, upright(self.source.recording.ground_truth)

    def _poses(self) -> Iterator[Sent]:
        """/odom, and in /tf the transforms map to odom and odom to body, at each pose."""
        lived, corrected = self.source.trajectory, self.source.corrected
        if lived is None:
            return
        if corrected is None and self.source.odom is not None:
            corrected = lived  # it leaps where more is known of the way: in the map
        lived = upright(in_odom(lived, self.source.odom))
        corrected = None if corrected is None else upright(corrected)
        known_s, T_map_odom = map_to_odom(lived, corrected)
        at = dict(zip(known_s.tolist(), T_map_odom, strict=True))
        C, moving, child = pose_covariances(lived), twists(lived), body_frame(lived.body)
        for row, (stamp_s, T) in enumerate(lived):
            known = None if C is None else C[row]
            yield Sent(stamp_s, ODOM_TOPIC, self.make.odometry(stamp_s, (ODOM, child), T, moving[row], known))
            joined = [(MAP, ODOM, at[stamp_s])] if stamp_s in at and self.fixed == MAP else []
            yield Sent(stamp_s, TF, self.make.transforms(stamp_s, [*joined, (ODOM, child, T)]))

    def _statuses(self) -> Iterator[Sent]:
        rows = sorted(self.source.status(), key=lambda row: row.stamp_s)
        for row in rows:
            message = f"{row.status}: {row.reason}" if row.reason else row.status
            diagnosis = Diagnosis(_LEVELS.get(row.status, _ERROR), "wheelsight: localization", message, row.details)
            yield Sent(row.stamp_s, DIAGNOSTICS_TOPIC, self.make.diagnostics(row.stamp_s, [diagnosis]))

    def _events(self) -> Iterator[Sent]:
        """Messages of the sensors; none, with a warning, if the run's recording is missing."""
        try:
            recording = self.source.recording
        except InputError as error:
            if self.parts.images is not None:
                raise
            self.warnings.append(f"There are no topics of sensors: {error}.")
            return
        if recording is None:
            if self.parts.images is not None:
                self.warnings.append("There are no images: only a recording, or a run of one, has them.")
            return
        for event in recording.events(images=self.parts.images is not None):
            yield from self.robot.of_event(event)


# Layouts of an exported bag, for Foxglove ("Import from file": panels by id, and how they share the window) and for
# RViz: RViz 2 for bags of ROS 2, and RViz 1, whose classes have other names, for bags of ROS 1.


_WAYS = {
    WAY_TOPIC: (0, 114, 178),
    TRUTH_TOPIC: (0, 158, 115),
    PLAN_TOPIC: (0, 114, 178),
}  # red, green, blue (Okabe & Ito 2008)
_COLOR_IMAGES = (f"{COLOR}/image_raw", f"{COLOR}/image_raw/compressed")
_LINE_M = 0.04
_POINT_PX = 3


def layout_paths(bag: Path) -> tuple[Path, Path]:
    """Paths of the layouts beside a bag: Foxglove's and RViz's."""
    return bag.with_suffix(".foxglove.json"), bag.with_suffix(".rviz")


def write_layouts(bag: Path, topics: Collection[str], fixed_frame: str) -> tuple[Path, Path]:
    """Write both layouts and return their paths. Raises OutputError."""
    paths = layout_paths(bag)
    write_text(paths[0], json.dumps(foxglove_layout(topics, fixed_frame), indent=2) + "\n")
    text = yaml.safe_dump(rviz_config(topics, fixed_frame, is_ros1=bag.suffix == ".bag"), sort_keys=False)
    write_text(paths[1], text)
    return paths


def foxglove_layout(topics: Collection[str], fixed_frame: str) -> dict[str, Any]:
    """3D with map, points and paths; beside it image, plots, diagnostics, stick and stop, by the topics."""
    drawn = (MAP_TOPIC, COSTMAP_TOPIC, ODOM_TOPIC, POSE_TOPIC, SCAN_TOPIC, MARKERS_TOPIC)
    shown: dict[str, Any] = {topic: {"visible": topic != COSTMAP_TOPIC} for topic in drawn if topic in topics}
    if POINTS_TOPIC in topics:
        look = {"colorField": "rgb", "colorMode": "rgb", "pointSize": _POINT_PX, "pointShape": "square"}
        shown[POINTS_TOPIC] = {"visible": True, **look}
    for topic, (red, green, blue) in _WAYS.items():
        if topic in topics:
            gradient = [f"#{red:02x}{green:02x}{blue:02x}"] * 2
            shown[topic] = {"visible": True, "type": "line", "lineWidth": _LINE_M, "gradient": gradient}
    grid = {"instanceId": "grid", "layerId": "foxglove.Grid", "label": "Grid", "visible": True, "frameLocked": True}
    scene: dict[str, Any] = {
        "followMode": "follow-none",
        "followTf": fixed_frame,
        "topics": shown,
        "layers": {"grid": {**grid, "size": 20, "divisions": 20, "lineWidth": 1, "color": "#b0b0b0"}},
        "cameraState": {"perspective": False, "distance": 20, "phi": 0, "thetaOffset": 0, "target": [0, 0, 0]},
    }
    if GOAL_TOPIC in topics:
        names = {"poseTopic": GOAL_TOPIC, "pointTopic": CLICKED_TOPIC, "poseEstimateTopic": INITIAL_TOPIC}
        scene["publish"] = {"type": "pose", **names}
    beside = dict(_panels_beside(topics))
    tree: Any = "3D!wheelsight"
    if beside:
        tree = {"first": tree, "second": _stacked([*beside]), "direction": "row", "splitPercentage": 68}
    return {
        "configById": {"3D!wheelsight": scene, **beside},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": tree,
    }


def _panels_beside(topics: Collection[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and settings of the panels beside the 3D view."""

    def plot(title: str, values: Iterable[str]) -> dict[str, Any]:
        paths = [{"value": value, "enabled": True, "timestampMethod": "headerStamp"} for value in values]
        return {"title": title, "paths": paths, "isSynced": True}

    if image := _image_of(topics):
        yield "Image!wheelsight", {"imageMode": {"imageTopic": image}}
    if ODOM_TOPIC in topics:
        speeds = (f"{ODOM_TOPIC}.twist.twist.{axis}" for axis in ("linear.x", "angular.z"))
        yield "Plot!wheelsight", plot("speed, m/s, and turn, rad/s", speeds)
    if POSE_TOPIC in topics:
        variances = (f"{POSE_TOPIC}.pose.covariance[{at}]" for at in (0, 7, 35))
        yield "Plot!covariance", plot("variance of x and y, m², and of yaw, rad²", variances)
    if DIAGNOSTICS_TOPIC in topics:
        yield "DiagnosticSummary!wheelsight", {"topicToRender": DIAGNOSTICS_TOPIC, "minLevel": 0}
    if VELOCITY_TOPIC in topics:
        ways = {"up": ("linear-x", 0.3), "down": ("linear-x", -0.1), "left": ("angular-z", 0.5)}
        ways["right"] = ("angular-z", -0.5)
        buttons = {f"{way}Button": {"field": name, "value": value} for way, (name, value) in ways.items()}
        yield "Teleop!wheelsight", {"topic": VELOCITY_TOPIC, "publishRate": 10, **buttons}
    if STOP_TOPIC in topics:
        button = {"buttonText": "STOP", "buttonColor": "#d55e00", "buttonTooltip": "stop the robot"}
        said = {"topicName": STOP_TOPIC, "datatype": "std_msgs/msg/Empty", "value": "{}"}
        yield "Publish!wheelsight", {**said, **button, "advancedView": False}


def _stacked(panels: list[str]) -> Any:
    """Panels of equal height, one above the other."""
    if len(panels) == 1:
        return panels[0]
    share = 100 / len(panels)
    return {"first": panels[0], "second": _stacked(panels[1:]), "direction": "column", "splitPercentage": share}


def rviz_config(topics: Collection[str], fixed_frame: str, *, is_ros1: bool) -> dict[str, Any]:
    """Displays of map, points, paths, odometry, transforms and image, by the topics of the bag, seen from above."""
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


def _rviz_image(display: dict[str, Any], topic: str, *, is_ros1: bool) -> dict[str, Any]:
    """The display of an image. RViz 1 names a compressed image by its raw topic and a transport."""
    if is_ros1:
        del display["Topic"]
        raw, _, transport = topic.partition("/image_raw")
        display |= {"Image Topic": f"{raw}/image_raw", "Transport Hint": transport.strip("/") or "raw"}
    return display


def _image_of(topics: Collection[str]) -> str | None:
    return next((topic for topic in _COLOR_IMAGES if topic in topics), None)
