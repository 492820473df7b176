"""What a file for Rerun holds, by Rerun's own reader."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from wheelsight.core.geometry import se3


class Shown:
    """All that a file holds: rows of each entity, by component and timeline."""

    def __init__(self, path: Path) -> None:
        self.rows: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        self.timelines: set[str] = set()
        for chunk in RrdReader(path).stream():
            self.timelines |= set(chunk.timeline_names)
            for name, values in chunk.to_record_batch().to_pydict().items():
                self.rows[chunk.entity_path][name] += values

    def times_s(self, place: str) -> np.ndarray:
        return np.array([value.total_seconds() for value in self.rows[place]["time"]])

    def transforms(self, place: str) -> np.ndarray:
        """(n, 4, 4); Rerun keeps matrices column by column."""
        rows = self.rows[place]
        R = np.array(rows["Transform3D:mat3x3"], float).reshape(-1, 3, 3).transpose(0, 2, 1)
        return np.asarray(se3.from_parts(R, np.array(rows["Transform3D:translation"], float).reshape(-1, 3)))
