"""What the progress bar of `wheelsight run` says beside its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from wheelsight.config import Config
from wheelsight.report import FrameRecord

COMPILING = "compiling kernels, once after installation"
# The first frame has nothing to be aligned with, so most kernels are compiled at the second.
_FRAMES_THAT_COMPILE = 2
# Of each part that compiles anything at all, a file whose kernels every run with it needs.
_KERNELS = {
    "features": ("wheelsight.odometry.features._kernels",),
    "dense": ("wheelsight.odometry.dense._alignment_kernels",),
    "surfels": ("wheelsight.mapping._fusion_kernels", "wheelsight.mapping._view_kernels"),
}


class RunStatus:
    """Each odometry's status, how large the map is, and, as long as it takes, that kernels are compiled.

    Args:
        settings: of the run.
        is_rehearsed: whether kernels are compiled before the first frame, as for a run in real time.

    Attributes:
        text: what to say now.
    """

    def __init__(self, settings: Config, is_rehearsed: bool = False) -> None:
        self._of_each: dict[str, str] = {}
        self._has_several = len(settings.tracks) > 1
        parts = (*settings.tracks, *([] if settings.map is None else [settings.map]))
        self._compiles = not kernels_are_compiled(parts)
        self._frames = _FRAMES_THAT_COMPILE if is_rehearsed else 0
        self.text = COMPILING if self._compiles else ""

    def after(self, answers: Mapping[str, FrameRecord]) -> str:
        """What to say after one more event, by each odometry's answer."""
        self._frames += any(odometry in _KERNELS for odometry in answers)
        self._of_each.update({odometry: _words(answer) for odometry, answer in answers.items()})
        if not self._compiles or self._frames >= _FRAMES_THAT_COMPILE:
            now = (f"{of} {words}" if self._has_several else words for of, words in self._of_each.items())
            self.text = ", ".join(now)
        return self.text


def kernels_are_compiled(parts: tuple[str, ...]) -> bool:
    """Whether what these parts of the package compile is in numba's cache, newer than its source."""
    return all(_is_compiled(name) for part in parts for name in _KERNELS.get(part, ()))


def _is_compiled(name: str) -> bool:
    module = import_module(name)
    source = Path(str(module.__file__))
    # Numba keeps all kernels of a file in one folder, and knows which.
    kernel = next(found for found in vars(module).values() if getattr(found, "__module__", "") == name)
    written_s = [path.stat().st_mtime for path in Path(kernel.stats.cache_path).glob(f"{source.stem}.*.nbi")]
    return max(written_s, default=0.0) >= source.stat().st_mtime


def _words(answer: FrameRecord) -> str:
    """Such as "tracking · 412k surfels"."""
    if answer.surfels is None:
        return str(answer.status)
    text = f"{answer.status} · {count(answer.surfels)} surfels"
    return f"{text}, {count(answer.surfels_dropped)} given up for want of room" if answer.surfels_dropped else text


def count(n: int) -> str:
    """A count in three digits or so: 950, 412k, 1.23M."""
    if n < 1000:
        return str(n)
    return f"{n / 1e3:.0f}k" if n < 999_500 else f"{n / 1e6:.2f}M"
