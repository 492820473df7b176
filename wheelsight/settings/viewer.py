"""ViewerSettings: how much of a run a viewer is shown."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting


class ViewerSettings(Settings):
    """Of `--rerun`; what a file of a run grows by."""

    image_rate_hz: float = setting(
        5.0, "images a second, of the recording's time: colour and depth; 0: none", CHOSEN, ge=0, le=1000
    )
    image_width_px: int = setting(320, "width to which wider images are brought", CHOSEN, ge=16, le=8192)
    jpeg_quality: int = setting(80, "of colour images", CHOSEN, ge=1, le=100)
    keyframe_points: int = setting(
        3000, "points of a keyframe at most, evenly over its image; 0: none", CHOSEN, ge=0, le=1_000_000
    )
    map_points: int = setting(
        50_000, "points of the finished surfel map at most; 0: none", CHOSEN, ge=0, le=100_000_000
    )
    costmap_rate_hz: float = setting(
        1.0,
        "of a drive: costmaps of the floor about the robot, and floors that grow, a second; 0: none",
        CHOSEN,
        ge=0,
        le=100,
    )
