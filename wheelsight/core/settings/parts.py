"""Settings of the localizer, place recognition, live cameras, the recorder, real time, the live page and the viewer."""

from __future__ import annotations

from wheelsight.core.settings.base import ASKED, CHOSEN, Settings, setting


class LocalizerSettings(Settings):
    """Memory of a localizer, and the size of its images."""

    memory_keyframes: int | None = setting(
        128,
        "without a map on disk, older keyframes than this number go to a temporary file; after twice as many they "
        "leave memory (180 kB each), but for this number of recently used ones; null: all stay in memory",
        "as `sessions.memory_keyframes`",
        ge=1,
        le=1_000_000,
    )
    most_width_px: int | None = setting(
        None,
        "wider images are halved until they are at most this wide; not with a model of places, which is trained on "
        "images of one size",
        ASKED,
        ge=16,
        le=8192,
    )
    resting_folder: str | None = setting(
        None, "folder of that temporary file; null: the system's folder of temporary files", CHOSEN
    )


class RecognitionSettings(Settings):
    """Recognition of places; see docs/recognition.md."""

    seed: int = setting(0, "of ferns and of RANSAC", CHOSEN, ge=0, lt=2**32)
    candidates: int = setting(
        64,
        "largest number of keyframes that are verified for one view; each wrong one costs 1 to 2 ms",
        "two real recordings of Kinects, docs/decisions/recognition-and-sessions.md",
        ge=1,
        le=1000,
    )


class LiveCameraSettings(Settings):
    """A live camera, or a file that is played as one."""

    width_px: int = setting(640, "width of the requested images", ASKED, ge=16, le=8192)
    height_px: int = setting(480, "height of the requested images", ASKED, ge=16, le=8192)
    rate_hz: int = setting(30, "requested frames a second", ASKED, ge=1, le=300)
    infrared: bool = setting(False, "request infrared images too, if the camera has them", ASKED)
    gyro: bool = setting(True, "read the camera's gyroscope too, if it has one", CHOSEN)
    topics: tuple[str, ...] = setting((), "topics of a bag that is played as a camera, as `recording.topics`", ASKED)
    registered: bool = setting(
        True, "request depth on the pixels of colour, if the camera can; calibration uses both as measured", ASKED
    )
    kept_frames: int = setting(
        4, "number of newest frames in memory; a recorder keeps more, to bridge a slow disk", CHOSEN, ge=1, le=1000
    )
    oldest_s: float = setting(
        1.0, "older frames, seconds, are not returned, because the robot has moved on", CHOSEN, gt=0, le=60
    )
    stall_s: float = setting(
        0.5,
        "a camera without a frame for this time is stalled, seconds; 15 periods of most cameras",
        CHOSEN,
        gt=0,
        le=60,
    )
    reopen_s: float = setting(
        3.0,
        "a camera that is stalled for this time is closed and opened again, seconds, as after unplugging; more than "
        "the time to set the exposure at the start",
        CHOSEN,
        gt=0,
        le=600,
    )


class RecorderSettings(Settings):
    """`wheelsight record`, and `run --live --record`."""

    longest_wait_s: float = setting(
        0.8,
        "frames are dropped, and counted, while another one has waited this time for the disk, seconds; below a "
        "second, so that the end of the program loses no more",
        CHOSEN,
        gt=0,
        le=60,
    )
    most_waiting: int = setting(
        60, "largest number of waiting frames: 130 MB of 640×480", "computed from 7 bytes a pixel", ge=1, le=10_000
    )
    writers: int = setting(
        2,
        "threads that encode and write images; a frame of 640×480 takes 17 ms, and waits 18 ms for the disk",
        "measured by benchmarks.recording on two cores",
        ge=1,
        le=64,
    )
    least_free_mb: float = setting(
        200.0, "recording ends if less space is left on the disk, MB, before other programs fail", CHOSEN, ge=0, le=1e6
    )


class RealTimeSettings(Settings):
    """A run with `--realtime`."""

    frames_ahead: int = setting(4, "largest number of frames decoded ahead", CHOSEN, ge=2, le=1000)
    dropped_share: float = setting(
        0.1, "share of dropped frames above which the run prints a remedy", CHOSEN, ge=0, le=1
    )


class LivePageSettings(Settings):
    """`wheelsight serve`."""

    updates_hz: float = setting(10.0, "updates a second to each page", "issue 34", gt=0, le=50)
    images_hz: float = setting(
        2.0, "most images of camera, map and costmap a second, for a phone's network", CHOSEN, gt=0, le=30
    )
    image_px: int = setting(320, "largest width of the camera's image, pixels", CHOSEN, ge=32, le=1920)
    old_s: float = setting(
        1.0, "a page without an update for this time shows so, and its plan in grey, seconds", "issue 34", ge=0.2, le=10
    )
    stops_without_driver: bool = setting(True, "stop the robot if the page that drives it disconnects", CHOSEN)
    driver_silent_s: float = setting(
        2.0,
        "a driver's page without a message for this time is disconnected, seconds: it sends two a second, one in a "
        "browser's background; a lost network closes no connection",
        CHOSEN,
        ge=0.6,
        le=60,
    )
    most_viewers: int = setting(8, "largest number of pages", CHOSEN, ge=1, le=200)


class ViewerSettings(Settings):
    """`--rerun`; each figure makes the file of a run larger."""

    image_rate_hz: float = setting(
        5.0, "images of colour and depth per second of the recording; 0: none", CHOSEN, ge=0, le=1000
    )
    keyframe_points: int = setting(
        3000, "largest number of points of a keyframe, evenly over its image; 0: none", CHOSEN, ge=0, le=1_000_000
    )
    map_points: int = setting(
        50_000, "largest number of points of the final surfel map; 0: none", CHOSEN, ge=0, le=100_000_000
    )
    costmap_rate_hz: float = setting(
        1.0, "of a drive: costmaps and growing floors per second; 0: none", CHOSEN, ge=0, le=100
    )
