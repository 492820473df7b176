"""WheelSettings: what can be set about wheels and the gyroscope beside them, with the reasons for the defaults."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from wheelsight.odometry.wheels.odometry import Integration
from wheelsight.settings import CHOSEN, ON_SIMULATOR, Settings, conflict, setting

_FROM_0002 = "docs/decisions/0002: three simulated flats, and the log of a real skid-steered robot"
_DATA_SHEETS = "reckoned from data sheets and tape measures"


class ReadingTimesSettings(Settings):
    """When readings were taken that are stamped when they arrive; see `ReadingTimes`."""

    speed_steps: int = setting(
        8,
        "steps over which the speed is a mean: the noise of stamps is a tenth of it then, and robots' speeds much the"
        " same",
        _FROM_0002,
        ge=2,
        le=1000,
    )
    acceleration_m_s2: float = setting(
        1.0, "how fast robots indoors speed up and brake, m/s²", "reckoned", gt=0, le=100
    )
    slowest_m_s: float = setting(0.03, "slower, m/s, a count more or less is much of the way", "reckoned", ge=0, le=10)
    stopping_share: float = setting(
        0.5, "a step of less than this share of the usual way is of a base that stops", _FROM_0002, ge=0, lt=1
    )
    gap_factor: float = setting(1.5, "a step so many times as long as usual, and", _FROM_0002, gt=1, le=100)
    gap_sigmas: float = setting(
        3.0, "longer than its way takes by so many standard deviations, has a gap in it", _FROM_0002, gt=0, le=100
    )
    waiting_share: float = setting(
        0.5,
        "those behind a gap waited too, until one is taken less than this share of a period before its stamp,",
        _FROM_0002,
        gt=0,
        le=10,
    )
    pace_share: float = setting(
        0.6,
        "or some come at their usual pace, as they do behind a second gap within the first: longer than this share of "
        "what their ways take,",
        _FROM_0002,
        gt=0,
        lt=1,
    )
    patience: int = setting(3, "so many of them", _FROM_0002, ge=1, le=1000)
    latest_s: float = setting(
        0.2,
        "no reading is believed to be farther off its stamp, seconds: filters take events so late",
        "reckoned",
        gt=0,
        le=10,
    )
    memory_steps: int = setting(
        40, "the noise of stamps is the root mean square over about so many steps on the way", _FROM_0002, ge=1, le=1e6
    )
    least_noise_s: float = setting(1e-3, "noise that is taken for granted at first, seconds", _FROM_0002, gt=0, le=1)
    exact_s: float = setting(
        3e-3,
        "less noise is none, seconds: wheels that count in steps make so much of it, and a clean drive stays the same",
        _FROM_0002,
        ge=0,
        le=1,
    )


class GyroCheckSettings(Settings):
    """Whether a gyroscope tells of the wheels' turns; see `GyroCheck`."""

    block_s: float = setting(0.25, "length of the blocks in which turns are compared, seconds", CHOSEN, gt=0, le=10)
    most_lag_s: float = setting(0.4, "lags that are looked for, either way, seconds", CHOSEN, gt=0, le=10)
    lags: int = setting(17, "how many, evenly spaced; odd, so that none is one of them", CHOSEN, ge=3, le=1001)
    turning_rad_s: float = setting(
        0.05, "turns of the wheels that count, rad/s; slower, counts and noise are most of it", "reckoned", gt=0, le=10
    )
    last_turns: int = setting(40, "turning blocks that are looked at: 10 s of turning", CHOSEN, ge=3, le=100_000)
    last_blocks: int = setting(400, "within so many blocks: 100 s", CHOSEN, ge=3, le=1_000_000)
    trust_after: int = setting(8, "turning blocks before it may be believed: 2 s", ON_SIMULATOR, ge=3, le=100_000)
    accuse_after: int = setting(20, "turning blocks before it may be left out: 5 s", ON_SIMULATOR, ge=3, le=100_000)
    lowest_scale: float = setting(
        0.85,
        "of its turns over those of the wheels: radii and tracks by tape measure, and gyroscopes by data sheet, are "
        "good to some percent",
        _DATA_SHEETS,
        gt=0,
        lt=1,
    )
    highest_scale: float = setting(1.15, "likewise", _DATA_SHEETS, gt=1, le=100)
    lowest_slipping_scale: float = setting(
        0.5, "the same of wheels that slip in turns, as a skid-steered robot's do", "one real drive", gt=0, lt=1
    )
    highest_slipping_scale: float = setting(1.3, "likewise", "one real drive", gt=1, le=100)
    slipping_scatter: float = setting(
        0.015,
        "share of the rate by which it is off the line from which on wheels slip in turns: 0.03 to 0.09 of a skid-"
        "steered robot, less than 0.01 of wheels that grip",
        "the first is a real drive, the others the simulator's",
        gt=0,
        lt=1,
    )
    sigmas: float = setting(3.0, "standard deviations by which a scale must lie outside", CHOSEN, gt=0, le=100)
    followed_share: float = setting(
        0.8, "share of the rates' variance that the line explains of one that is believed", ON_SIMULATOR, gt=0, lt=1
    )
    deaf_share: float = setting(
        0.5, "share below which it tells of other turns than the wheels", ON_SIMULATOR, gt=0, lt=1
    )
    late_s: float = setting(
        0.1,
        "lag that is worth a word, seconds: wheels' stamps are late by some 0.05 s where nobody measured their delay",
        "reckoned",
        gt=0,
        le=10,
    )
    clearer: float = setting(2.0, "so many times less is left at the best lag", ON_SIMULATOR, ge=1, le=1000)
    recent_blocks: int = setting(4, "blocks in which it must agree to be kept: one second", CHOSEN, ge=1, le=100_000)
    stuck_s: float = setting(1.0, "the same number for so long, seconds, is of one that is stuck,", CHOSEN, gt=0, le=60)
    stuck_rad: float = setting(
        0.2,
        "while the wheels turned by so much else, radians: more than they slip in that time",
        ON_SIMULATOR,
        gt=0,
        le=10,
    )
    stuck_blocks: int = setting(40, "in so many blocks, at most: 10 s", CHOSEN, ge=2, le=100_000)
    unheard_s: float = setting(1.0, "so long it is waited for, seconds", CHOSEN, gt=0, le=60)
    kept_s: float = setting(
        2.0,
        "how far back the way goes on by the wheels alone where it fails, seconds: longer than it takes to notice",
        "reckoned",
        gt=0,
        le=600,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.lags % 2 == 0:
            raise conflict("lags", f"is {self.lags}, and none of them is 0", "an odd number")
        if self.last_blocks < self.last_turns:
            problem = f"is {self.last_blocks}, less than last_turns: {self.last_turns}"
            raise conflict("last_blocks", problem, "let last_blocks be the larger")
        for name in ("trust_after", "accuse_after"):
            if getattr(self, name) > self.last_blocks:
                problem = f"is {getattr(self, name)}, more than last_blocks: {self.last_blocks}"
                raise conflict(name, problem, "let last_blocks be the larger")
        if self.followed_share < self.deaf_share:
            problem = f"is {self.followed_share:g}, less than deaf_share: {self.deaf_share:g}"
            raise conflict("followed_share", problem, "let followed_share be the larger")
        return self


class WheelSettings(Settings):
    """How wheel readings become a pose."""

    integration: Integration = setting(
        "arc", "of a step: exact, by Ligocki's eq. 1 (midpoint), or by Trinh's eq. 3 (euler)", "the papers"
    )
    gyro: bool = setting(
        True,
        "join the yaw rates of a gyroscope, where the recording has them",
        "docs/wheel-odometry.md: a real skid-steered robot, and ten simulated drives",
    )
    gyro_gap_s: float = setting(
        0.1, "a gyroscope that is silent for longer tells no turn between two readings, seconds", CHOSEN, gt=0, le=10
    )
    reading_times: ReadingTimesSettings = ReadingTimesSettings()
    gyro_check: GyroCheckSettings = GyroCheckSettings()
