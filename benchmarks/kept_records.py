"""KeptRecords: a folder of what was measured, one file each, so that hours of it can be broken off and go on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wheelsight.core.errors import InputError
from wheelsight.core.files import write_text


@dataclass(frozen=True)
class KeptRecords:
    """All measured in one way.

    Attributes:
        folder: of a file for each; None keeps nothing.
        measured_with: what they depend on besides, which each file repeats.
    """

    folder: Path | None
    measured_with: dict[str, Any]

    def of(self, name: str) -> Any | None:
        """What was kept by that name, if anything. Raises InputError for a file that was measured otherwise."""
        if self.folder is None or not (path := self.folder / f"{name}.json").exists():
            return None
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["measured_with"] != self.measured_with or "found" not in record:
            raise InputError("was measured otherwise", path=path, fix="keep these in another folder")
        return record["found"]

    def keep(self, name: str, found: Any) -> None:
        """Write a file, whole or not at all; `found` is of what JSON knows."""
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            record = {"found": found, "measured_with": self.measured_with}
            write_text(self.folder / f"{name}.json", json.dumps(record, indent=1))
