"""A map that is whole: written once, and a copy to damage."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from sessions.kept_views import COUNT, write_map


@pytest.fixture(autouse=True)
def short_journals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three keyframes in each."""
    monkeypatch.setattr("wheelsight.slam.maps.folder._JOURNAL_KEYFRAMES", 3)


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """To be read alone."""
    path = tmp_path_factory.mktemp("maps") / "map"
    write_map(path, COUNT)
    return path


@pytest.fixture
def copied(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(written, tmp_path / "map"))
