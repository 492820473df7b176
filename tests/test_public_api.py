"""What every public function promises alike: paths as text, and types that a strict checker of a user's code takes."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wheelsight
from wheelsight import Trajectory, read_kitti, read_tum, write_kitti, write_tum

_NOT_IMPORTED = ("cli", "__main__")
_ANSWERS = ("Exported.__init__", "LabelFile.__init__", "LabelSource.__init__")  # made by readers, not by users


def packages() -> list[str]:
    below = [module.name for module in pkgutil.iter_modules(wheelsight.__path__)]
    odometries = [f"odometry.{name}" for name in ("dense", "extrinsics", "features", "wheels")]
    names = [name for name in (*below, *odometries) if name not in _NOT_IMPORTED]
    return ["wheelsight", *(f"wheelsight.{name}" for name in names)]


def functions_of(package: str) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Public functions of a package, and those of its public classes."""
    module = importlib.import_module(package)
    for name in getattr(module, "__all__", [name for name in vars(module) if not name.startswith("_")]):
        found = getattr(module, name)
        if inspect.isfunction(found):
            yield name, found
        elif inspect.isclass(found):
            for below, method in vars(found).items():
                plain = getattr(method, "__func__", method)
                if inspect.isfunction(plain) and (not below.startswith("_") or below == "__init__"):
                    yield f"{name}.{below}", plain


@pytest.mark.parametrize("package", packages())
def test_what_takes_a_path_takes_text(package: str) -> None:
    """Readers alone, which `open_recording` chooses among, and what serves it, are handed folders."""
    wrong = []
    for name, function in functions_of(package):
        for parameter, kind in getattr(function, "__annotations__", {}).items():
            is_ours = function.__module__.startswith("wheelsight.") and name not in _ANSWERS
            takes_text = "StrPath" in str(kind) or "PathLike" in str(kind)
            if is_ours and parameter != "return" and re.search(r"\bPath\b", str(kind)) and not takes_text:
                wrong.append(f"{name}({parameter}: {kind})")
    assert not wrong


def test_text_does_for_paths(tmp_path: Path) -> None:
    way = Trajectory(np.arange(3.0), np.tile(np.eye(4), (3, 1, 1)))
    for write, read in ((write_tum, read_tum), (write_kitti, read_kitti)):
        write(way, str(tmp_path / "way.txt"))
        assert len(read(str(tmp_path / "way.txt"))) == 3


USERS_CODE = """
from pathlib import Path

from wheelsight import (
    Calibration, Config, Localizer, OpenOptions, PinholeCamera, load_calibration, open_recording, read_tum, run,
)
from wheelsight.config import RecordingSettings, ReportSettings
from wheelsight.odometry.features import FeatureSettings

recording = open_recording("room", OpenOptions(calibration=["a.yaml", Path("b.yaml")]))
record = run(recording, Config(), "out")
calibration: Calibration = load_calibration("calibration.yaml", "mount.yaml")
localizer = Localizer(recording.calibration, Config(odometry=("wheels", "dense"), map="surfels"))
for event in recording.events():
    estimate = localizer.process(event)
    if estimate is not None and estimate.T_odom_body is not None:
        print(estimate.T_odom_body[:3, 3], estimate.status)
settings = Config(features=FeatureSettings(seed=3), report=ReportSettings(pictures=8), recording=RecordingSettings())
print(read_tum("trajectory.txt").length_m, settings.to_dict())
"""


@pytest.mark.slow
def test_a_strict_checker_takes_a_users_code(tmp_path: Path) -> None:
    """mypy --strict, without pydantic's plugin."""
    (tmp_path / "users.py").write_text(USERS_CODE)
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = true\n")
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--follow-imports", "silent", "users.py"]
    environment = {"MYPYPATH": str(Path(wheelsight.__file__).parent.parent), "PATH": "/usr/bin"}
    told = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
