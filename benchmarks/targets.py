"""What wheelsight must reach, and how far it is from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.contenders import opencv_odometry, wheelsight_features
from benchmarks.run import Figures, Result
from benchmarks.startup import Startup

ATE_SHARE_OF_BETTER_PEER = 0.5
MEDIAN_MS = 12.0
TIME_SHARE_OF_OPENCV = 0.3
PEAK_MEMORY_MB = 500.0
IMPORT_S = 0.3
HELP_S = 0.5
SUBJECT = wheelsight_features.KEYFRAMES.name


@dataclass(frozen=True, slots=True)
class Target:
    """A figure and the limit it must not exceed; None where one of them was not measured."""

    what: str
    limit: float | None
    measured: float | None
    unit: str
    decimals: int = 1

    @property
    def is_met(self) -> bool | None:
        """None where it cannot be told."""
        return None if self.limit is None or self.measured is None else self.measured <= self.limit

    @property
    def verdict(self) -> str:
        """In words: met, or missed by how much."""
        if self.limit is None or self.measured is None:
            return "not measured"
        if self.measured <= self.limit:
            return "met"
        over = self.measured - self.limit
        share = f" ({100 * over / self.limit:.0f} %)" if self.limit else ""
        return f"missed by {over:.{self.decimals}f} {self.unit}{share}"


def judge(results: Sequence[Result], startup: Startup | None) -> list[Target]:
    """All targets, by sequence; those of start-up last."""
    targets = [
        target
        for name in dict.fromkeys(result.sequence for result in results)
        for target in _of_sequence(name, results)
    ]
    if startup is not None:
        targets.append(Target("`import wheelsight`, beyond bare Python", IMPORT_S, startup.import_alone_s, "s", 3))
        targets.append(Target("`wheelsight --help`", HELP_S, startup.help_s, "s", 3))
    return targets


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
