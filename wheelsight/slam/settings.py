"""Settings of loop closing and of the maps that are kept between drives."""

from __future__ import annotations

from wheelsight.core.settings import ASKED, CHOSEN, Settings, setting
from wheelsight.mapping import OccupancySettings

FROM_NOWHERE, FROM_MATCHES, FROM_KEYFRAMES = "none", "matches", "keyframes"
"""Values of `LoopSettings.source`, other than the path of a file."""


class LoopSettings(Settings):
    """Source of loops; see docs/loops.md."""

    source: str = setting(
        "none",
        "none; keyframes: places that the camera sees again, while driving; matches: those of the recording, and of a "
        "loops.csv in its folder; or a file like that",
        ASKED,
    )
    latency_s: float = setting(
        1.0,
        "time after which the result of a recording's keyframe is used, in seconds of its stamps: "
        "reproducible on each machine",
        "estimated: recognition and verification take a tenth or two of it",
        ge=0,
        le=60,
    )
    apart_s: float = setting(
        3.0, "least time between two keyframes of a loop, seconds: odometry links recent ones", CHOSEN, ge=0, le=3600
    )


class SessionSettings(Settings):
    """Map folder of a run; see docs/sessions.md."""

    keep_map: bool | None = setting(
        None, "whether the run writes a map folder for the next drive; null: if `map: surfels` builds a map", ASKED
    )
    flush_s: float = setting(
        1.0,
        "seconds between flushes, after which data survives a loss of power",
        "estimated: a fifth of what a kill may cost",
        gt=0,
        le=60,
    )
    memory_keyframes: int = setting(
        128,
        "keyframes of a map held in memory, the most recently used: 23 MB; twice as many of a drive that "
        "writes one, the newest; older ones are read from disk",
        "what an hour of driving may take, 1 GB: docs/decisions/maps-in-memory-and-on-disk.md",
        ge=1,
        le=1_000_000,
    )
    most_kb: int = setting(
        86,
        "largest size of a keyframe, kilobytes; if images leave no room for all keypoints, some are left out, evenly",
        "what issue 31 allows, 100 kB, without what recognises it, its pose and its edges",
        ge=1,
        le=100_000,
    )
    occupancy: OccupancySettings = OccupancySettings()
