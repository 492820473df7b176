"""LiveCameraSettings: what a live camera is asked for, and when its frames count as lost, old or wrongly stamped."""

from __future__ import annotations

from wheelsight.settings.base import ASKED, CHOSEN, Settings, setting


class LiveCameraSettings(Settings):
    """Of a camera that is plugged in, or a file that is played as one."""

    width_px: int = setting(640, "width of the images that are asked for", ASKED, ge=16, le=8192)
    height_px: int = setting(480, "height of the images that are asked for", ASKED, ge=16, le=8192)
    rate_hz: int = setting(30, "frames a second that are asked for", ASKED, ge=1, le=300)
    infrared: bool = setting(False, "whether infrared images are asked for too, where the camera has them", ASKED)
    gyro: bool = setting(True, "whether the gyroscope of a camera that has one is read, too", CHOSEN)
    topics: tuple[str, ...] = setting(
        (), "of a bag that is played as a camera: which topics are what, as `recording.topics` says it", ASKED
    )
    registered: bool = setting(
        True,
        "whether depth is asked for on colour's pixels, where the camera can; calibrating takes both as measured",
        ASKED,
    )
    kept_frames: int = setting(
        4,
        "newest frames that are kept for whoever asks; a recorder keeps more, to bridge a slow disk",
        CHOSEN,
        ge=1,
        le=1000,
    )
    oldest_s: float = setting(
        1.0,
        "a frame that is older than so many seconds when it is fetched is not handed out: the robot has driven on",
        CHOSEN,
        gt=0,
        le=60,
    )
    stall_s: float = setting(
        0.5,
        "without a frame for so many seconds, 15 of most cameras' periods, it counts as stalled",
        CHOSEN,
        gt=0,
        le=60,
    )
    reopen_s: float = setting(
        3.0,
        "a camera that is stalled for so many seconds is closed and opened again, as after unplugging; more than "
        "cameras take to set their exposure at their start",
        CHOSEN,
        gt=0,
        le=600,
    )
    retry_s: float = setting(
        0.25, "seconds between two looks for a camera that was unplugged, of the 2 s it may take", CHOSEN, gt=0, le=2
    )
    pair_gap_s: float = setting(
        0.02,
        "largest distance in time between colour and depth of one frame, seconds: over half of a period at 30 Hz, "
        "under one",
        "reckoned from the period",
        gt=0,
        le=1,
    )
    clock_ahead_s: float = setting(
        0.1,
        "a stamp that lies so many seconds after its frame's arrival tells that the camera's clock leapt",
        CHOSEN,
        gt=0,
        le=10,
    )
    clock_late_s: float = setting(
        0.3,
        "frames that all arrive so many seconds after their stamps, over `clock_watch_s`, tell that it leapt back",
        CHOSEN,
        gt=0,
        le=10,
    )
    clock_drift: float = setting(
        5e-4,
        "largest share by which the camera's clock runs faster or slower than the host's: five times what crystals of "
        "cameras differ by, so that a busy host's delays are not taken for drift",
        CHOSEN,
        gt=0,
        le=0.01,
    )
    clock_watch_s: float = setting(
        2.0, "over so many seconds: a host that was busy has caught up by then", CHOSEN, gt=0, le=60
    )
