"""Layouts beside exported bags: the topics that they show are in the bag, and what of ours can be shown is shown."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from bag_contents import messages_in
from synthetic import make_tum_recording

from wheelsight_export import BagParts, export_bag, exported_at
from wheelsight_export.bag import foxglove_layout, layout_paths, rviz_config

SENSORS = {"/tf", "/tf_static", "/joint_states", "/imu/data", "/wheelsight/calibration"}


def foxglove_topics(layout: dict[str, Any]) -> set[str]:
    """Of all panels."""
    panels = layout["configById"]
    found = set(panels["3D!wheelsight"]["topics"])
    found |= {panels[name]["imageMode"]["imageTopic"] for name in panels if name.startswith("Image!")}
    found |= {panels[name]["topicToRender"] for name in panels if name.startswith("DiagnosticSummary!")}
    for name in panels:
        if name.startswith("Plot!"):
            found |= {path["value"].split(".")[0] for path in panels[name]["paths"]}
    return found


def panels_in(tree: Any) -> Iterator[str]:
    """The panels that share the window."""
    if isinstance(tree, str):
        yield tree
    else:
        yield from panels_in(tree["first"])
        yield from panels_in(tree["second"])


def rviz_topics(config: dict[str, Any]) -> set[str]:
    """Of all displays."""
    found = set()
    for display in config["Visualization Manager"]["Displays"]:
        topic = display.get("Topic")
        if isinstance(topic, dict):
            found.add(topic["Value"])
        elif topic is not None:
            found.add(topic)
        if "Image Topic" in display:
            transport = display["Transport Hint"]
            found.add(display["Image Topic"] + ("" if transport == "raw" else f"/{transport}"))
    return found


def check(bag: Path, fixed_frame: str) -> set[str]:
    """Both layouts against what another reader finds in the bag; the topics that they show."""
    written = {message.topic for message in messages_in(bag)}
    foxglove, rviz = layout_paths(bag)
    layout, config = json.loads(foxglove.read_text()), yaml.safe_load(rviz.read_text())
    shown = foxglove_topics(layout)
    assert shown <= written
    assert rviz_topics(config) == shown - {"/diagnostics"}  # RViz has no display of these
    assert set(panels_in(layout["layout"])) == set(layout["configById"])
    assert layout["configById"]["3D!wheelsight"]["followTf"] == fixed_frame
    manager = config["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == fixed_frame
    kinds = {display["Class"].split("/")[0] for display in manager["Displays"]}
    assert kinds == {"rviz" if bag.suffix == ".bag" else "rviz_default_plugins"}
    return shown


@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
@pytest.mark.parametrize("images", ["raw", "jpeg"])
def test_a_recordings_layouts_show_its_images(tmp_path: Path, suffix: str, images: Any) -> None:
    make_tum_recording(tmp_path / "room", frames=3)
    bag = tmp_path / f"room{suffix}"
    report = export_bag(exported_at(tmp_path / "room"), bag, BagParts(images))
    assert report.layouts == layout_paths(bag)
    shown = check(bag, "map")
    assert shown == {"/ground_truth", "/camera/color/image_raw" + ("" if images == "raw" else "/compressed")}


def test_a_maps_layouts_show_its_floor(kept_map: Path, tmp_path: Path) -> None:
    export_bag(exported_at(kept_map), tmp_path / "map.mcap")
    assert check(tmp_path / "map.mcap", "map") == {"/map", "/trajectory"}
    displays = yaml.safe_load((tmp_path / "map.rviz").read_text())["Visualization Manager"]["Displays"]
    latched = {one["Topic"]["Value"] for one in displays if one.get("Topic", {}).get("Durability Policy")}
    assert latched == {"/map", "/trajectory"}


def test_all_that_can_be_shown_is_shown() -> None:
    topics = {"/map", "/map_points", "/trajectory", "/odom", "/diagnostics", "/camera/color/image_raw"}
    assert foxglove_topics(foxglove_layout(topics | SENSORS, "odom")) == topics
    for is_ros1 in (False, True):
        assert rviz_topics(rviz_config(topics | SENSORS, "odom", is_ros1=is_ros1)) == topics - {"/diagnostics"}
