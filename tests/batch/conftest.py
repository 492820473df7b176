"""What tests of batches share."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic import make_tum_recording


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A sound recording of ten frames."""
    (tmp_path / "room").mkdir()
    make_tum_recording(tmp_path / "room", frames=10)
    return tmp_path / "room"
