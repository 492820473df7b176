"""What wheelsight must reach, and how far it is from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.contenders import opencv_odometry, wheelsight_features
from benchmarks.firmware import FirmwareFigures
from benchmarks.link import LinkFigures
from benchmarks.run import Figures, Result
from benchmarks.startup import Startup
from benchmarks.wheels import WheelTimes

ATE_SHARE_OF_BETTER_PEER = 0.5
MEDIAN_MS = 12.0
TIME_SHARE_OF_OPENCV = 0.3
PEAK_MEMORY_MB = 500.0
IMPORT_S = 0.3
HELP_S = 0.5
LOG_MS, UPDATE_US = 100.0, 10.0
DECODE_MB_S, LATENCY_MS = 5.0, 2.0
CRC_RATE = 65_536
PULSES_PER_S = 7833
FLASH_BYTES, RAM_BYTES = 8192, 1024
SUBJECT = wheelsight_features.KEYFRAMES.name


@dataclass(frozen=True, slots=True)
class Target:
    """A figure and the limit it must not exceed, or must reach; None where one of them was not measured."""

    what: str
    limit: float | None
    measured: float | None
    unit: str
    decimals: int = 1
    is_least: bool = False

    @property
    def is_met(self) -> bool | None:
        """None where it cannot be reported."""
        if self.limit is None or self.measured is None:
            return None
        return self.measured >= self.limit if self.is_least else self.measured <= self.limit

    @property
    def verdict(self) -> str:
        """In words: met, or missed by how much."""
        if self.limit is None or self.measured is None:
            return "not measured"
        if self.is_met:
            return "met"
        off = abs(self.measured - self.limit)
        share = f" ({100 * off / self.limit:.0f} %)" if self.limit else ""
        return f"missed by {off:.{self.decimals}f} {self.unit}{share}"


def judge(results: Sequence[Result]) -> list[Target]:
    """The targets of the side-by-side comparison, by sequence."""
    return [
        target
        for name in dict.fromkeys(result.sequence for result in results)
        for target in _of_sequence(name, results)
    ]


def judge_startup(startup: Startup) -> list[Target]:
    """What starting may take."""
    return [
        Target("`import wheelsight`, beyond bare Python", IMPORT_S, startup.import_alone_s, "s", 3),
        Target("`wheelsight --help`", HELP_S, startup.help_s, "s", 3),
    ]


def judge_wheels(times: WheelTimes) -> list[Target]:
    """What dead reckoning may take."""
    return [
        Target(f"wheels: {times.samples:,} samples with covariance", LOG_MS, times.log_ms, "ms"),
        Target("wheels: one reading of a stream, to its Estimate", UPDATE_US, times.update_us, "µs"),
    ]


def judge_link(figures: LinkFigures) -> list[Target]:
    """What the serial link must reach: speed, and not to be misled.

    Damage that flips enough bits passes 16 bits of CRC once in 65,536 frames; one run in a thousand may have more than
    the limit by chance.
    """
    from scipy.stats import poisson

    noise, damaged = figures.noise, figures.damaged
    by_chance = float(poisson.ppf(0.999, damaged.damaged / CRC_RATE))
    late_ms = float(np.percentile(figures.latency_ms, 99))
    return [
        Target("link: decode, framed", DECODE_MB_S, figures.decode_mb_s, "MB/s", 1, is_least=True),
        Target("link: decode, format recognised", DECODE_MB_S, figures.recognised_mb_s, "MB/s", 1, is_least=True),
        Target("link: last byte of a frame to the pose on the pipe, 99th percentile", LATENCY_MS, late_ms, "ms", 2),
        Target(f"link: messages in {noise.decoder.statistics.bytes:,} random bytes", 0, noise.wrong, "messages", 0),
        Target(f"link: wrong counts of {damaged.damaged:,} damaged frames", by_chance, damaged.wrong, "counts", 0),
        Target("link: second sound frames after damage that were missed", 0, damaged.missed, "frames", 0),
    ]


def judge_firmware(figures: FirmwareFigures) -> list[Target]:
    """What the wheel controller must reach: the paper's motors at their top speed, on a chip of 8 KB and 1 KB."""
    rate = figures.pulses_per_s
    return [
        Target("firmware: pulses/s on both wheels at once, none lost", PULSES_PER_S, rate, "/s", 0, is_least=True),
        Target("firmware: flash", FLASH_BYTES, figures.flash_bytes, "bytes", 0),
        Target("firmware: memory for data", RAM_BYTES, figures.ram_bytes, "bytes", 0),
    ]


def _of_sequence(name: str, results: Sequence[Result]) -> Iterator[Target]:
    here = {r.contender.name: r.figures for r in results if r.sequence == name and r.figures is not None}
    ours, opencv = here.get(SUBJECT), here.get(opencv_odometry.RGB_DEPTH.name)

    def own(figure: Callable[[Figures], float | None]) -> float | None:
        return None if ours is None else figure(ours)

    share = TIME_SHARE_OF_OPENCV * opencv.median_ms if opencv else None
    ate_m = own(lambda figures: figures.accuracy.ate_m)
    yield Target(f"{name}: ATE, half of the better peer's", _ate_limit_m(name, results, False), ate_m, "m", 4)
    if registered := _ate_limit_m(name, results, True):
        yield Target(f"{name}: ATE, the same with depth registered for the peers", registered, ate_m, "m", 4)
    yield Target(f"{name}: median time a frame", MEDIAN_MS, own(lambda f: f.median_ms), "ms")
    yield Target(f"{name}: median time, 0.3 of OpenCV's", share, own(lambda f: f.median_ms), "ms")
    yield Target(f"{name}: peak memory", PEAK_MEMORY_MB, own(lambda f: f.peak_memory_mb), "MB", 0)
    yield Target(f"{name}: poses that differ between two runs", 0, own(lambda f: f.differing_poses), "poses", 0)


def _ate_limit_m(name: str, results: Sequence[Result], registered: bool) -> float | None:
    """The ATE to reach, by the better of the peers that got the images as recorded, or registered."""
    peers = [r for r in results if r.sequence == name and r.contender.is_peer and r.contender.registers == registered]
    reached = [r.figures.accuracy.ate_m for r in peers if r.figures is not None]
    known = [ate_m for ate_m in reached if ate_m is not None]
    return ATE_SHARE_OF_BETTER_PEER * min(known) if known else None
