"""Figures of joined drives, kept one by one: hours of measuring can be interrupted, and shared among processes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.joined_cases import CASES, Case
from benchmarks.joined_figures import Accuracy, JoinedFigures
from benchmarks.kept_records import KeptRecords


@dataclass(frozen=True, slots=True)
class KeptFigures:
    """A folder of figures that were all measured in one way.

    Attributes:
        folder: of the files, one a case and seed; None keeps nothing.
        measured_with: what they depend on besides, which each file repeats.
    """

    folder: Path | None
    measured_with: Mapping[str, Any]

    def of(self, case: Case, seed: int) -> JoinedFigures | None:
        """What was measured before, if anything.

        Raises InputError for a file that was measured otherwise.
        """
        record = self._records.of(_name_of(case, seed))
        return None if record is None else _read(record)

    def keep(self, figures: JoinedFigures) -> None:
        """Write a file, whole or not at all."""
        self._records.keep(_name_of(figures.case, figures.seed), {**asdict(figures), "case": figures.case.name})

    @property
    def _records(self) -> KeptRecords:
        return KeptRecords(self.folder, dict(self.measured_with))


def _name_of(case: Case, seed: int) -> str:
    return f"{re.sub('[^a-z0-9]+', '-', case.name.lower())}-{seed}"


def _read(record: dict[str, Any]) -> JoinedFigures:
    case = next(case for case in CASES if case.name == record["case"])
    accuracy = {name: Accuracy(**figures) for name, figures in record["accuracy"].items()}
    right, within = (tuple(record[name]) for name in ("right", "within"))
    return JoinedFigures(case, record["seed"], accuracy, right, within, record["back_s"], record["false_slip"])
