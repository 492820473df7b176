from __future__ import annotations

from pathlib import Path

import pytest
from sessions.mounted_maps import WAY, drive


@pytest.fixture(scope="session")
def kept_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map folder of a robot whose camera sits on its base, with its occupancy map; no one changes it."""
    folder = tmp_path_factory.mktemp("maps") / "map"
    drive(folder, WAY).close()
    return folder
