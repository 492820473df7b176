"""Maps of first days and what was measured in them, kept in a folder: hours of it can be broken off and go on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from benchmarks.kept_records import KeptRecords
from benchmarks.session_starts import Building, FirstDay, first_day

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

One = TypeVar("One", bound="DataclassInstance")

_POSES = ("T_world_map", "T_world_base", "T_map_base")


def kept_day(
    building: Building, folder: Path, measured_with: dict[str, Any], rate_hz: float, units: Path | None = None
) -> FirstDay:
    """The first day that `folder` has of a building, or else one that is driven now, and is kept there.

    `measured_with` is what its map depends on besides. Raises InputError where the folder has one of another kind.
    """
    records = KeptRecords(folder, measured_with)
    reported = records.of(building.name)
    if reported is None:
        day = first_day(building, folder / building.name, rate_hz, units)
        records.keep(building.name, _reported(day, folder))
        return day
    poses = {
        name: np.array(reported.pop(name)).reshape((-1, 4, 4) if name != "T_world_map" else (4, 4)) for name in _POSES
    }
    return FirstDay(**{**reported, "folder": folder / reported["folder"], **poses})


def kept_one(records: KeptRecords, name: str, kind: type[One], measured: Callable[[], One]) -> One:
    """What was kept by that name, or else what is measured now, and is kept."""
    reported = records.of(name)
    if reported is None:
        one = measured()
        records.keep(name, asdict(one))
        return one
    known: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in reported.items()}
    return kind(**known)


def _reported(day: FirstDay, folder: Path) -> dict[str, Any]:
    """What JSON knows of it; its map by where that lies in the folder, so that both may be moved."""
    poses = {name: getattr(day, name).tolist() for name in _POSES}
    numbers = {name: getattr(day, name) for name in ("ate_m", "way_m", "keyframes", "together")}
    return {"name": day.name, "folder": str(day.folder.relative_to(folder)), **numbers, **poses}
