"""What was measured when: the `history` of a calibration file, one entry a calibration, which loading does not need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from wheelsight.calibration_fields import mapping, number
from wheelsight.calibration_layers import HISTORY
from wheelsight.errors import CalibrationError

_FIELDS = ("date", "command", "what", "figures")
_MOST_ENTRIES = 10_000


@dataclass(frozen=True, slots=True)
class Measured:
    """One calibration.

    Attributes:
        what: of which parts of the robot.
        command: that found it, as it was typed but for options.
        figures: what it is worth, by name with its unit.
        date: of the day, in UTC, as 2026-11-26 13:05.
    """

    what: str
    command: str
    figures: Mapping[str, float] = field(default_factory=dict)
    date: str = ""

    def as_field(self) -> dict[str, Any]:
        """The entry as a file has it; without a date, that of now."""
        date = self.date or datetime.now(UTC).strftime("%Y-%m-%d %H:%M")
        figures = {name: float(f"{value:.4g}") for name, value in self.figures.items()}
        return {"date": date, "command": self.command, "what": self.what, "figures": figures}


def history_of(document: Mapping[str, Any]) -> tuple[Measured, ...]:
    """The history of a calibration file's fields, oldest first. Raises CalibrationError for what is none."""
    entries = document.get(HISTORY, [])
    if not isinstance(entries, list) or len(entries) > _MOST_ENTRIES:
        raise CalibrationError(f"field {HISTORY} must be a list of what was measured")
    found = []
    for entry in entries:
        known = mapping(entry, HISTORY, _FIELDS)
        figures = known.get("figures", {})
        if not isinstance(figures, dict):
            raise CalibrationError(f"field {HISTORY}: figures must hold names and numbers")
        numbers = {str(name): number(value, f"{HISTORY}.{name}") for name, value in figures.items()}
        what, command, date = (str(known.get(name, "")) for name in ("what", "command", "date"))
        found.append(Measured(what, command, numbers, date))
    return tuple(found)
