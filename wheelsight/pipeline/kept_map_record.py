"""KeptMapRecord: the map folder that a run leaves for the next."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class KeptMapRecord:
    """The map folder of one track.

    Attributes:
        file: its name in the track's folder.
        keyframes: how many it holds.
        bytes: of all its files.
        warnings: what could not be written, and why.
    """

    file: str
    keyframes: int
    bytes: int
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """For metrics.json."""
        return {name: value for name, value in asdict(self).items() if name != "warnings"}

    @property
    def sentence(self) -> str:
        """How large it is."""
        return f"{self.keyframes:,} keyframes, {self.bytes / 1e6:.1f} MB"
