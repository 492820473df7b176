"""RealTimeSettings: how a recording is played in real time, and what is said of how that went."""

from __future__ import annotations

from wheelsight.settings.base import CHOSEN, Settings, setting


class RealTimeSettings(Settings):
    """Of a run with `--realtime`."""

    frames_ahead: int = setting(
        4,
        "frames that are decoded ahead, at most",
        CHOSEN,
        ge=2,
        le=1000,
    )
    readings_ahead_s: float = setting(
        1.0,
        "so far ahead readings of wheels and gyroscopes are read, seconds",
        CHOSEN,
        gt=0,
        le=60,
    )
    dropped_share: float = setting(
        0.1, "share of dropped frames beyond which the run says what to do about it", CHOSEN, ge=0, le=1
    )
    recent_frames: int = setting(
        30, "frames over which progress tells rate and latency: one second of most cameras", CHOSEN, ge=2, le=100_000
    )
    rehearsed_frames: int = setting(
        3,
        "frames answered before time begins to run, so that kernels are compiled or loaded",
        CHOSEN,
        ge=1,
        le=1000,
    )
