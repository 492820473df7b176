from __future__ import annotations

from pathlib import Path

import pytest
from synthetic import make_tum_recording


@pytest.fixture(scope="session")
def bench_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as the benchmark takes it, with one short recording of the room in it."""
    folder = tmp_path_factory.mktemp("bench")
    make_tum_recording(folder / "rgbd" / "room", frames=8)
    return folder
