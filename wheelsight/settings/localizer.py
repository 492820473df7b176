"""LocalizerSettings: what a localizer goes by beyond odometry, map and filter."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.settings.base import ASKED, CHOSEN, ON_SIMULATOR, Settings, conflict, setting


class BaseCheckSettings(Settings):
    """Whether wheels and camera tell of one drive, over its first metres; see `BaseCheck`."""

    enough_m: float = setting(
        3.0,
        "way, metres, that must have been compared before both are known to tell of one drive; what comes later is "
        "slip, and is the filter's to tell",
        ON_SIMULATOR,
        gt=0,
        le=1000,
    )
    enough_rad: float = setting(
        1.5, "turns, radians, that must have been compared likewise", ON_SIMULATOR, gt=0, le=100
    )
    likely_m: float = setting(
        0.05,
        "by how many metres both must be apart before a factor is likely: whoever looks or turns elsewhere shows it in "
        "any piece, but a factor may be the work of clocks that are apart, by 0.1 s at half a metre a second",
        "reckoned from clocks and speeds",
        ge=0,
        le=100,
    )
    likely_rad: float = setting(
        0.1, "likewise in radians, at a radian a second", "reckoned from clocks and speeds", ge=0, le=10
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
        "way, metres, after which a floor that is not where the mount has it is held against nobody",
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
        "a camera that was left out is compared anew after so many times `enough_m` without a verdict: what was wrong "
        "long ago counts no more",
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
        100, "frames, at most, that wait for wheels which are not heard: 3 s of most cameras", CHOSEN, ge=1, le=100_000
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
        "reckoned",
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
        0.4, "latest one, seconds: three frames of 10 a second, and 0.1 s of clocks", "reckoned", ge=0, le=10
    )
    lag_step_s: float = setting(0.02, "from one to the next, seconds: finer than a frame", "reckoned", gt=0, le=1)
    latest_frames: int = setting(3, "frames by which colour may be late that are looked for", CHOSEN, ge=1, le=100)
    least_lag_s: float = setting(
        0.05, "a lag that is worth a word, seconds; a frame of 30 a second is less", ON_SIMULATOR, ge=0, le=10
    )
    fewest_shifts: int = setting(
        20, "shifts that must be known before anything is told", ON_SIMULATOR, ge=3, le=100_000
    )
    most_shifts: int = setting(
        600, "shifts that are kept: the last minute of turning at 10 frames a second", "reckoned", ge=3, le=1_000_000
    )
    most_readings: int = setting(
        20_000, "headings by the wheels that are kept beside them", CHOSEN, ge=2, le=10_000_000
    )
    least_turn_rad: float = setting(
        0.5, "turns that must have been seen before anything is told, radians", ON_SIMULATOR, gt=0, le=100
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
        "reckoned from cameras of 1 Hz and more",
        ge=0,
        le=3600,
    )
    moved_m: float = setting(
        0.0005,
        "by the wheels, metres from frame to frame: less than a robot that creeps at 2 cm/s, while one that stands "
        "turns no wheel at all",
        "reckoned",
        ge=0,
        le=10,
    )
    moved_rad: float = setting(0.0005, "likewise in radians", "reckoned", ge=0, le=10)


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
