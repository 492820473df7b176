from __future__ import annotations

from pathlib import Path

import pytest
from sessions.kept_views import COUNT

from wheelsight.core.errors import MapError
from wheelsight.slam.maps import MapFolder, discard_map


def test_two_writers_never_write_one_map(copied: Path) -> None:
    first = MapFolder.open(copied, read_only=False)
    with pytest.raises(MapError, match=r"another run, of process \d+, writes this map"):
        MapFolder.open(copied, read_only=False)
    with pytest.raises(MapError, match="another run"):
        discard_map(copied)
    assert len(MapFolder.open(copied).store) == COUNT  # to read it does no harm
    first.close()
    MapFolder.open(copied, read_only=False).close()


def test_a_lock_that_a_dead_process_left_locks_nothing(copied: Path) -> None:
    (copied / "lock").write_text("1\n")
    MapFolder.open(copied, read_only=False).close()
