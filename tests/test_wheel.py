"""A wheel builds, installs in a fresh environment with the core's dependencies only, and does its main job there."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from synthetic import make_tum_recording

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def run(*command: str | Path, folder: Path) -> str:
    """Run a command outside the project, so that only what is installed can be imported."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def pip(environment_bin: Path, *arguments: str | Path, folder: Path) -> str:
    """What this environment's pip does, or says, in another that has none."""
    return run(sys.executable, "-m", "pip", "--python", environment_bin / "python", *arguments, folder=folder)


@pytest.fixture(scope="module")
def wheel(project_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, project_folder, folder=folder)
    (path,) = folder.glob("wheelsight-*.whl")
    return path


@pytest.fixture(scope="module")
def fresh_bin(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fresh")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", folder=folder)
    # What nobody imports here need not be translated: it is half of the work.
    pip(folder / "venv/bin", "install", "-q", "--no-compile", wheel, folder=folder)
    return folder / "venv/bin"


def test_the_wheel_holds_the_package_with_its_data_and_nothing_else(wheel: Path, project_folder: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    sources = {
        path.relative_to(project_folder).as_posix()
        for path in (project_folder / "wheelsight").rglob("*.*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in names if name.startswith("wheelsight/")} == sources
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert all(name.startswith(("wheelsight/", "wheelsight-")) for name in names)


def test_the_installed_command_explains_itself(fresh_bin: Path, tmp_path: Path) -> None:
    text = run(fresh_bin / "wheelsight", "--help", folder=tmp_path)
    assert all(command in text for command in ("info", "run", "evaluate"))


def test_the_installed_command_tracks_a_recording(fresh_bin: Path, tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=10)
    run(fresh_bin / "wheelsight", "run", "room", "--odometry", "features", "--out", "results", folder=tmp_path)
    poses = np.loadtxt(tmp_path / "results" / "trajectory.txt")
    assert poses.shape == (10, 8)
    assert not (tmp_path / "results" / "report.html").exists()  # it needs the extra `report`


def test_the_installed_dependencies_agree(fresh_bin: Path, tmp_path: Path) -> None:
    assert "No broken requirements" in pip(fresh_bin, "check", folder=tmp_path)
