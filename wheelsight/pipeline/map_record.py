"""MapRecord: what a run's map came to, with the pictures that the report shows of it."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.geometry import ByteArray
from wheelsight.mapping import MapStatus
from wheelsight.mapping.cloud import MapCloud
from wheelsight.mapping.plan import Plan


@dataclass(frozen=True, slots=True, eq=False)
class MapPicture:
    """What the camera saw, and what the finished map looks like from there.

    Attributes:
        stamp_s: of the frame, seconds.
        color: (H, W, 3) uint8, red green blue: the frame's.
        rendered: (h, w, 3) uint8 likewise, of the same view: the map's; white where it has nothing.
    """

    stamp_s: float
    color: ByteArray
    rendered: ByteArray


@dataclass(frozen=True, slots=True, eq=False)
class MapRecord:
    """A run's map.

    Attributes:
        status: how it stands at the end.
        fused: how many frames were averaged into it.
        file: its name in the run's folder.
        plan: it from above, or None where it is empty.
        pictures: it along the way.
        is_levelled: whether the calibration tells which way is up, and not the surfels alone.
        cloud: it as a few points, to be turned on the page, or None.
    """

    status: MapStatus
    fused: int
    file: str
    plan: Plan | None
    pictures: tuple[MapPicture, ...] = ()
    is_levelled: bool = True
    cloud: MapCloud | None = None

    @property
    def sentence(self) -> str:
        """How large it is."""
        return f"{self.status.surfels:,} surfels, {self.status.stable:,} of them stable"
