"""What the progress bar of `wheelsight run` says beside its numbers."""

from __future__ import annotations

from collections.abc import Mapping

from wheelsight.pipeline import FrameRecord

_JOINED = "joined"


class RunStatus:
    """Each odometry's status and how large the map is; that of joined sensors first, which is what counts."""

    def __init__(self) -> None:
        self._of_each: dict[str, str] = {}

    def after(self, answers: Mapping[str, FrameRecord]) -> str:
        """What to say after one more event, by each odometry's answer."""
        self._of_each.update({odometry: _words(answer) for odometry, answer in answers.items()})
        if len(self._of_each) == 1:
            return next(iter(self._of_each.values()))
        first = sorted(self._of_each, key=lambda odometry: odometry != _JOINED)
        return ", ".join(f"{odometry} {self._of_each[odometry]}" for odometry in first)


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
