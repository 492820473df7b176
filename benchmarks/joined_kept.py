"""Figures of joined drives, kept one by one: hours of measuring can be interrupted, and shared among processes."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.joined_cases import CASES, Case
from benchmarks.joined_figures import Accuracy, JoinedFigures
from wheelsight.errors import InputError
from wheelsight.files import write_text


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
        if self.folder is None or not self._path(case, seed).exists():
            return None
        record = json.loads(self._path(case, seed).read_text())
        if record.pop("measured_with") != dict(self.measured_with):
            raise InputError("was measured otherwise", path=self._path(case, seed), fix="keep these in another folder")
        return _read(record)

    def keep(self, figures: JoinedFigures) -> None:
        """Write a file, whole or not at all."""
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            record = {**asdict(figures), "case": figures.case.name, "measured_with": dict(self.measured_with)}
            write_text(self._path(figures.case, figures.seed), json.dumps(record, indent=1))

    def _path(self, case: Case, seed: int) -> Path:
        assert self.folder is not None
        return self.folder / f"{re.sub('[^a-z0-9]+', '-', case.name.lower())}-{seed}.json"


def _read(record: dict[str, Any]) -> JoinedFigures:
    case = next(case for case in CASES if case.name == record["case"])
    accuracy = {name: Accuracy(**figures) for name, figures in record["accuracy"].items()}
    right, within = (tuple(record[name]) for name in ("right", "within"))
    return JoinedFigures(case, record["seed"], accuracy, right, within, record["back_s"], record["false_slip"])
