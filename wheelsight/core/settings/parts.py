"""Settings of the localizer, of place recognition, of live cameras and recorders, of playback in real time, of the
live page and of the viewer.
"""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.core.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, conflict, setting

# LocalizerSettings: what a localizer goes by beyond odometry, map and filter.


class BaseCheckSettings(Settings):
    """Whether wheels and camera agree over the first metres of a drive; see `BaseCheck`."""

    enough_m: float = setting(
        3.0,
        "distance, metres, that is compared before both are known to agree; later disagreements are slip, which the "
        "filter detects",
        ON_SIMULATOR,
        gt=0,
        le=1000,
    )
    enough_rad: float = setting(
        1.5, "turns, radians, that must have been compared likewise", ON_SIMULATOR, gt=0, le=100
    )
    likely_m: float = setting(
        0.05,
        "difference of both in metres before a factor is likely: a rotated mount or a wrong sign shows in "
        "any piece, but a factor may be the work of clocks that are apart, by 0.1 s at half a metre a second",
        "computed from clocks and speeds",
        ge=0,
        le=100,
    )
    likely_rad: float = setting(
        0.1, "likewise in radians, at a radian a second", "computed from clocks and speeds", ge=0, le=10
    )
    sure_pieces: int = setting(
        8, "pieces of some centimetres or degrees after which what was found may be sure", ON_SIMULATOR, ge=1, le=10_000
    )
    sure_m: float = setting(0.5, "way, metres, or", ON_SIMULATOR, ge=0, le=1000)
    sure_rad: float = setting(0.6, "turns, radians, after which it is", ON_SIMULATOR, ge=0, le=100)
    sure_slip_m: float = setting(
        1.5,
        "the same for a factor of the wheels, metres: wheels slip by a factor, too, and where the camera leads then "
        "anyway it is no haste",
        ON_SIMULATOR,
        ge=0,
        le=1000,
    )
    sure_slip_rad: float = setting(1.5, "likewise, radians", ON_SIMULATOR, ge=0, le=100)
    blind_m: float = setting(
        1.0,
        "way by the wheels, metres, after which a camera that sees the floor elsewhere and is hardly followed is left"
        " out",
        ON_SIMULATOR,
        gt=0,
        le=1000,
    )
    blind_share: float = setting(
        0.2, "share of its frames below which a camera is hardly followed", ON_SIMULATOR, ge=0, le=1
    )
    agreed_m: float = setting(
        0.3,
        "distance, metres, after which a floor at another height than the mount's is ignored",
        ON_SIMULATOR,
        ge=0,
        le=1000,
    )
    floor_views: int = setting(
        5, "views that show the lowest floor so far, of which the median counts", ON_SIMULATOR, ge=1, le=10_000
    )
    floor_rows: int = setting(30, "rows of the depth image that are looked at for it", CHOSEN, ge=4, le=2000)
    floor_factor: float = setting(
        1.2,
        "factor of the camera's height by which the floor must lie elsewhere; mount, tilt and what lies on it make "
        "less",
        ON_SIMULATOR,
        gt=1,
        le=100,
    )
    again_ways: float = setting(
        3.0,
        "a camera that was left out is compared again after this multiple of `enough_m` without a decision: an old "
        "fault counts no more",
        CHOSEN,
        gt=1,
        le=1000,
    )
    again_keyframes: int = setting(
        20, "keyframes, at most, by which a camera that was left out is followed", CHOSEN, ge=1, le=10_000
    )
    kept_s: float = setting(
        3.0, "how long poses by the wheels are kept for frames that come late, seconds", CHOSEN, gt=0, le=600
    )
    waiting_frames: int = setting(
        100, "largest number of frames that wait for silent wheels: 3 s of most cameras", CHOSEN, ge=1, le=100_000
    )
    silent_s: float = setting(
        0.5,
        "wheels that have been silent for longer answer nothing, seconds: the gap that they bridge",
        "as a calibration's max_gap_s",
        gt=0,
        le=60,
    )
    gyro_after_s: float = setting(
        0.1, "how old the gyroscope's last reading may be at the end of a piece, seconds", CHOSEN, ge=0, le=10
    )


class ColorCheckSettings(Settings):
    """Whether colour is later than its depth; see `ColorCheck` and docs/decisions/0003."""

    width_px: int = setting(
        80, "width to which images are reduced before shifts are looked for, pixels", ON_SIMULATOR, ge=16, le=4096
    )
    nearest_m: float = setting(
        0.3, "nearer depth counts as this, metres: no depth camera sees nearer", "data sheets", gt=0, le=10
    )
    most_px: int = setting(
        12,
        "shift between two frames that is looked for, in the reduced image's pixels: 70° a second at 10 frames a "
        "second",
        "computed",
        ge=1,
        le=1000,
    )
    alike: float = setting(
        0.45, "response, of 1, below which what was found is no shift of the image", ON_SIMULATOR, gt=0, lt=1
    )
    shift_px: float = setting(
        0.5, "by which a shift is off, as a scale for outliers, pixels", ON_SIMULATOR, gt=0, le=100
    )
    clock_s: float = setting(
        0.03,
        "by which the clocks of camera and wheels are usually apart, seconds, as a standard deviation",
        CHOSEN,
        gt=0,
        le=10,
    )
    first_lag_s: float = setting(-0.2, "earliest lag that is looked for, seconds", CHOSEN, ge=-10, le=0)
    last_lag_s: float = setting(
        0.4, "latest one, seconds: three frames of 10 a second, and 0.1 s of clocks", "computed", ge=0, le=10
    )
    lag_step_s: float = setting(0.02, "from one to the next, seconds: finer than a frame", "computed", gt=0, le=1)
    latest_frames: int = setting(3, "frames by which colour may be late that are looked for", CHOSEN, ge=1, le=100)
    least_lag_s: float = setting(
        0.05, "a lag that is worth a word, seconds; a frame of 30 a second is less", ON_SIMULATOR, ge=0, le=10
    )
    fewest_shifts: int = setting(20, "shifts that must be known before a result", ON_SIMULATOR, ge=3, le=100_000)
    most_shifts: int = setting(
        600, "shifts that are kept: the last minute of turning at 10 frames a second", "computed", ge=3, le=1_000_000
    )
    most_readings: int = setting(
        20_000, "headings by the wheels that are kept beside them", CHOSEN, ge=2, le=10_000_000
    )
    least_turn_rad: float = setting(
        0.5, "rotations that must have been observed before a result, radians", ON_SIMULATOR, gt=0, le=100
    )
    likely: float = setting(
        6.0, "twice the logarithm of how much likelier late colour must be to be likely", ON_SIMULATOR, ge=0, le=1e6
    )
    sure: float = setting(
        20.0,
        "the same to be sure, either way: colour that is late is certain after 14 to 22 s in flats",
        ON_SIMULATOR,
        ge=0,
        le=1e6,
    )
    followed_share: float = setting(
        0.7,
        "of the shifts that turns must explain: of images that move as the wheels turn 86 % and more are, of wheels "
        "that spin under a half (flats and floors)",
        ON_SIMULATOR,
        gt=0,
        lt=1,
    )
    every_frames: int = setting(5, "frames between two judgements", CHOSEN, ge=1, le=10_000)
    turning_s: float = setting(
        0.6, "so long after a turn an image that is late may still show it, seconds", ON_SIMULATOR, gt=0, le=60
    )
    turning_rad: float = setting(
        0.01, "turn within that time from which on shifts are looked for, radians", ON_SIMULATOR, gt=0, le=10
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.sure < self.likely:
            raise conflict("sure", f"is {self.sure:g}, less than likely: {self.likely:g}", "let sure be the larger")
        if self.most_shifts < self.fewest_shifts:
            problem = f"is {self.most_shifts}, less than fewest_shifts: {self.fewest_shifts}"
            raise conflict("most_shifts", problem, "let most_shifts be the larger")
        if self.last_lag_s - self.first_lag_s < 2 * self.lag_step_s:
            problem = f"is {self.lag_step_s:g}, too long for lags from {self.first_lag_s:g} to {self.last_lag_s:g}"
            raise conflict("lag_step_s", problem, "a tenth of that at most")
        return self


class FrameGateSettings(Settings):
    """Which frames are worth processing; see `FrameGate`."""

    wait_s: float = setting(
        1.0, "so long wheels are waited for at the start, seconds: they begin the clock", CHOSEN, ge=0, le=3600
    )
    hangs_s: float = setting(
        1.0,
        "an image that repeats for longer is of a camera that hangs, seconds; cameras are logged at some times their "
        "rate",
        "computed from cameras of 1 Hz and more",
        ge=0,
        le=3600,
    )
    moved_m: float = setting(
        0.0005,
        "by the wheels, metres from frame to frame: less than a robot that creeps at 2 cm/s, while one that stands "
        "turns no wheel at all",
        "computed",
        ge=0,
        le=10,
    )
    moved_rad: float = setting(0.0005, "likewise in radians", "computed", ge=0, le=10)


class LocalizerSettings(Settings):
    """What a localizer goes by beyond odometry, map and filter."""

    base_check: BaseCheckSettings = BaseCheckSettings()
    color_check: ColorCheckSettings = ColorCheckSettings()
    frame_gate: FrameGateSettings = FrameGateSettings()
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
    pace_s: float = setting(
        0.35,
        "where wheels slip, the camera is expected to go on as it went; over a longer gap, seconds, the mean velocity "
        "says little of that at the frame",
        ON_SIMULATOR,
        gt=0,
        le=60,
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
