"""Settings of the localizer, of place recognition, of live cameras and recorders, of playback in real time, of the
live page and of the viewer.
"""

from __future__ import annotations

from wheelsight.core.settings.base import ASKED, CHOSEN, Settings, setting


class LocalizerSettings(Settings):
    """Memory of a localizer, and the size of its images."""

    memory_keyframes: int | None = setting(
        128,
        "where no map is written: keyframes that so many newer ones follow go to a temporary file, as they are, and "
        "leave memory after twice as many, 180 kB each; of those so many are held that were asked for last; null: all "
        "stay",
        "as `sessions.memory_keyframes`",
        ge=1,
        le=1_000_000,
    )
    most_width_px: int | None = setting(
        None,
        "images wider than this are halved until they are not, before anything looks at them; with a model of places, "
        "which is trained on images of one size, they stay as they are",
        ASKED,
        ge=16,
        le=8192,
    )
    resting_folder: str | None = setting(
        None, "in which that file is; none for the system's folder of temporary files", CHOSEN
    )


# RecognitionSettings: by what a place is recognised.


class RecognitionSettings(Settings):
    """How places are recognised; see docs/recognition.md."""

    seed: int = setting(0, "of ferns and of RANSAC", CHOSEN, ge=0, lt=2**32)
    candidates: int = setting(
        64,
        "largest number of keyframes that are verified for one view: one that shows another place costs 1 to 2 ms",
        "two real recordings of Kinects, docs/decisions/recognition-and-sessions.md",
        ge=1,
        le=1000,
    )


# LiveCameraSettings: what a live camera is asked for, and when its frames count as lost, old or wrongly stamped.


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
        "number of newest frames in memory; a recorder keeps more, to bridge a slow disk",
        CHOSEN,
        ge=1,
        le=1000,
    )
    oldest_s: float = setting(
        1.0,
        "a frame older than this many seconds is not returned, because the robot has moved on",
        CHOSEN,
        gt=0,
        le=60,
    )
    stall_s: float = setting(
        0.5,
        "seconds without a frame, 15 periods of most cameras, after which it counts as stalled",
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


# RecorderSettings: how what live sensors say is written to the disk, and when that ends.


class RecorderSettings(Settings):
    """Of `wheelsight record`, and of `run --live --record`."""

    longest_wait_s: float = setting(
        0.8,
        "a frame that comes while another has waited so long for the disk is dropped, and counted; under a second, so "
        "that whatever ends the program loses no more",
        CHOSEN,
        gt=0,
        le=60,
    )
    most_waiting: int = setting(
        60,
        "frames that wait at most, whatever their rate: 130 MB of 640×480",
        "computed from 7 bytes a pixel",
        ge=1,
        le=10_000,
    )
    writers: int = setting(
        2,
        "threads that encode and write images; a frame of 640×480 keeps one for 17 ms, and waits 18 ms for the disk",
        "measured by benchmarks.recording on two cores",
        ge=1,
        le=64,
    )
    least_free_mb: float = setting(
        200.0,
        "recording ends when so little room is left on the disk, MB, before other programs fail for want of it",
        CHOSEN,
        ge=0,
        le=1e6,
    )


# RealTimeSettings: how a recording is played in real time, and what is said of how that went.


class RealTimeSettings(Settings):
    """Of a run with `--realtime`."""

    frames_ahead: int = setting(
        4,
        "frames that are decoded ahead, at most",
        CHOSEN,
        ge=2,
        le=1000,
    )
    dropped_share: float = setting(
        0.1, "share of dropped frames beyond which the run says what to do about it", CHOSEN, ge=0, le=1
    )


# LivePageSettings: what the page of `wheelsight serve` shows, how often, and what it takes from whom.


class LivePageSettings(Settings):
    """Of `wheelsight serve`."""

    updates_hz: float = setting(10.0, "updates a second to each page", "issue 34", gt=0, le=50)
    images_hz: float = setting(
        2.0, "images of the camera, the map and the costmap a second, at most: a phone's network", CHOSEN, gt=0, le=30
    )
    image_px: int = setting(320, "width of the camera's image, at most, pixels", CHOSEN, ge=32, le=1920)
    old_s: float = setting(
        1.0, "a page without an update for so long says so, and shows its plan in grey", "issue 34", ge=0.2, le=10
    )
    stops_without_driver: bool = setting(True, "whether the robot stops if the page that drives it disconnects", CHOSEN)
    driver_silent_s: float = setting(
        2.0,
        "a driver's page that says nothing for so long is gone: it says so twice a second, once where a browser has it "
        "in the background; a network that is lost closes no connection",
        CHOSEN,
        ge=0.6,
        le=60,
    )
    most_viewers: int = setting(8, "pages at once", CHOSEN, ge=1, le=200)


# ViewerSettings: how much of a run a viewer is shown.


class ViewerSettings(Settings):
    """Of `--rerun`; what a file of a run grows by."""

    image_rate_hz: float = setting(
        5.0, "images a second, of the recording's time: colour and depth; 0: none", CHOSEN, ge=0, le=1000
    )
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
