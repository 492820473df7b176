"""How the viewer opens: the map large at the left; images, statuses and curves at the right; one timeline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from wheelsight.extras import needed

TIMELINE = "time"
MAP, ODOM, OTHERS = "map", "map/odom", "map/others"
ROBOT, TRAIL, KEYFRAMES, LOOPS, SURFELS = f"{ODOM}/robot", f"{ODOM}/trail", "map/keyframes", "map/loops", "map/surfels"
CAMERA = f"{ROBOT}/camera"
COLOR, DEPTH = f"{CAMERA}/color", f"{CAMERA}/depth"
FLOOR, COSTMAP, PLAN, GOAL, PREDICTED = "map/floor", "map/costmap", "map/plan", "map/goal", "map/predicted"
STATUS, CURVES, WORDS = "status", "curves", "words"


def blueprint_of(tracks: Sequence[str]) -> Any:
    """Of a run that follows `tracks`."""
    return _blueprint([TRAIL, *(f"{OTHERS}/{name}/trail" for name in tracks)], "Inliers and milliseconds")


def drive_blueprint() -> Any:
    """Of a drive to goals."""
    return _blueprint([TRAIL], "Speeds and way to go")


def _blueprint(trails: Sequence[str], curves: str) -> Any:
    """Trails are shown up to the moment that is looked at."""
    rrb = needed("rerun.blueprint")
    until_now = rrb.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    overrides = {trail: rrb.VisibleTimeRanges([until_now]) for trail in trails}
    side = [
        rrb.Horizontal(rrb.Spatial2DView(origin=COLOR, name="Camera"), rrb.Spatial2DView(origin=DEPTH, name="Depth")),
        rrb.StateTimelineView(origin=STATUS, name="Status"),
        rrb.TimeSeriesView(origin=CURVES, name=curves),
        rrb.TextLogView(origin=WORDS, name="What was said"),
    ]
    view = rrb.Spatial3DView(origin=MAP, name="Map", overrides=overrides)
    return rrb.Blueprint(
        rrb.Horizontal(view, rrb.Vertical(*side, row_shares=[3, 1.5, 2, 1.5]), column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="collapsed"),
    )
