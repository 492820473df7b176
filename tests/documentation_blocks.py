"""The python blocks of README and docs as files that a type checker reads; what they take for given is declared."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from pathlib import Path

# What a block may use without making it: its type, and where that is imported from.
GIVEN = {
    "T_base_camera": ("FloatArray", "wheelsight.core.geometry"),
    "T_keyframe_body": ("FloatArray", "wheelsight.core.geometry"),
    "T_map_camera": ("FloatArray", "wheelsight.core.geometry"),
    "T_map_keyframe": ("FloatArray", "wheelsight.core.geometry"),
    "T_map_base": ("FloatArray", "wheelsight.core.geometry"),
    "T_filter_odom": ("FloatArray", "wheelsight.core.geometry"),
    "T_map_odom": ("FloatArray", "wheelsight.core.geometry"),
    "T_odom_body": ("FloatArray", "wheelsight.core.geometry"),
    "T_prev_now": ("FloatArray", "wheelsight.core.geometry"),
    "Keypoints": ("type[VisualOdometry]", "wheelsight"),
    "DrawnRobot": ("type[Robot]", "wheelsight.core.robots"),
    "begin_s": ("float", ""),
    "camera": ("PinholeCamera", "wheelsight"),
    "calibration": ("Calibration", "wheelsight"),
    "clockwise_m": ("FloatArray", "wheelsight.core.geometry"),
    "counter_clockwise_m": ("FloatArray", "wheelsight.core.geometry"),
    "covariance": ("FloatArray", "wheelsight.core.geometry"),
    "edits": ("MapEdits", "wheelsight.mapping"),
    "estimate": ("Estimate", "wheelsight.core.estimates"),
    "events": ("list[Event]", "wheelsight.core.messages"),
    "floor": ("Floor", "wheelsight.navigation"),
    "frame": ("RgbdFrame", "wheelsight"),
    "grid": ("OccupancyGrid", "wheelsight.mapping"),
    "intrinsics": ("FloatArray", "wheelsight.core.geometry"),
    "lead": ("_Callable[..., NavigationResult]", "wheelsight.navigation"),
    "layer": ("LiveLayer", "wheelsight.navigation"),
    "localization": ("Localization", "wheelsight.navigation"),
    "localizer": ("Localizer", "wheelsight"),
    "looked": ("_Callable[..., RgbdFrame]", "wheelsight"),
    "loops": ("list[RelativePose]", "wheelsight.slam"),
    "motion": ("MotionEstimate", "wheelsight"),
    "my_robot": ("EventSource", "wheelsight"),
    "now_s": ("float", ""),
    "p_camera": ("FloatArray", "wheelsight.core.geometry"),
    "paint": ("ByteArray", "wheelsight.core.geometry"),
    "path": ("Path", "pathlib"),
    "record": ("RunRecord", "wheelsight"),
    "recording": ("Recording", "wheelsight"),
    "reference": ("Trajectory", "wheelsight"),
    "robot": ("Robot", "wheelsight.core.robots"),
    "source": ("EventSource", "wheelsight"),
    "stamp_s": ("float", ""),
    "store": ("KeyframeStore", "wheelsight"),
    "wheels": ("Wheels", "wheelsight"),
    # Imports that an earlier block of the page has shown.
    "FeatureOdometry": ("", "wheelsight"),
    "save_calibration": ("", "wheelsight"),
    "se3": ("", "wheelsight.core.geometry"),
}

# Settings made and a drive localized as no page shows it.
USERS_CODE = """
from pathlib import Path

from wheelsight import (
    Calibration, Config, Localizer, OpenOptions, PinholeCamera, load_calibration, open_recording, read_tum, run,
)
from wheelsight.config import ReportSettings
from wheelsight.vision.features import FeatureSettings

recording = open_recording("room", OpenOptions(calibration=["a.yaml", Path("b.yaml")]))
record = run(recording, Config(), "out")
calibration: Calibration = load_calibration("calibration.yaml", "mount.yaml")
localizer = Localizer(recording.calibration, Config(odometry=("wheels", "dense"), map="surfels"))
for event in recording.events():
    estimate = localizer.process(event)
    if estimate is not None and estimate.T_odom_body is not None:
        print(estimate.T_odom_body[:3, 3], estimate.status)
settings = Config(features=FeatureSettings(seed=3), report=ReportSettings(pictures=8), recording=OpenOptions())
print(read_tum("trajectory.txt").length_m, settings.to_dict())
"""


def python_blocks(page: Path) -> Iterator[tuple[int, str]]:
    """Each block of a page with its line."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        yield text[: found.start()].count("\n") + 2, found.group(1)


def declared(block: str) -> str:
    """The block below declarations of what it uses and no one made. Raises KeyError for a name that is not GIVEN."""
    lines = ["from typing import Any as _Any, Callable as _Callable", "_given: _Any = None"]
    for name in unmade(block):
        kind, module = GIVEN[name]
        word = re.sub(r".*[\[ ]|\]", "", kind) or name
        lines += [f"from {module} import {word}"] if module else []
        lines += [f"{name}: {kind} = _given"] if kind else []
    return "\n".join([*dict.fromkeys(lines), block])


def unmade(block: str) -> list[str]:
    """Names that are read, and that nothing in the block makes."""
    tree = ast.parse(block)
    nodes = list(ast.walk(tree))
    names = [node for node in nodes if isinstance(node, ast.Name)]
    members = [child for node in nodes if isinstance(node, ast.ClassDef) for child in node.body]
    of_classes = {id(node) for child in members if isinstance(child, ast.Assign) for node in ast.walk(child)}
    made = {node.id for node in names if isinstance(node.ctx, ast.Store) and id(node) not in of_classes}
    made |= set(dir(builtins)) | {"__name__"} | {node.arg for node in nodes if isinstance(node, ast.arg)}
    made |= {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            made |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    methods = {child.name for child in members if isinstance(child, ast.FunctionDef)}
    loads = (node for node in names if isinstance(node.ctx, ast.Load))
    read = {node.id for node in loads if not (id(node) in of_classes and node.id in methods)}
    return sorted(read - made)
