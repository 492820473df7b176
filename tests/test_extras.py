"""Without the libraries that extras bring the core runs, and what needs them says what to install."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from pipeline.made import wheel_recording
from typer.testing import CliRunner, Result

import wheelsight
from wheelsight.app.cli import app
from wheelsight.app.run import kernels
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import needed, why_missing
from wheelsight.io.recordings import write_recording

LIBRARIES = ("plotly", "rerun", "sklearn", "skops")
ROOT = Path(wheelsight.__file__).parent
MODULES = [
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in sorted(ROOT.rglob("*.py"))
    if path.name != "__main__.py"
]
BLOCK = f"import sys; sys.modules.update(dict.fromkeys({LIBRARIES}))\n"


def run_without(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run Python in `folder` that cannot import the libraries of extras."""
    path = [str(ROOT.parent), *(entry for entry in sys.path if entry)]
    code = f"import sys; sys.path[:0] = {path!r}\n{BLOCK}{code}"
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def wheelsight_without(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Result]:
    """Runs a command in `tmp_path` and this process, which cannot import the libraries of extras either."""
    loaded = {name for name in sys.modules if name.partition(".")[0] in LIBRARIES}
    for name in loaded.union(LIBRARIES):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(kernels, "missing_parts", lambda parts: ())  # what is said of that has its own test
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(app, arguments)


def test_no_module_loads_them_when_imported(tmp_path: Path) -> None:
    code = f"from importlib import import_module\nfor name in {MODULES!r}: import_module(name)\nprint(len(sys.modules))"
    done = run_without(code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_a_run_without_plotly_leaves_all_but_the_page_and_says_what_to_install(
    wheelsight_without: Callable[..., Result], tmp_path: Path
) -> None:
    write_recording(tmp_path / "drive", wheel_recording(100))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("of an earlier run")
    done = wheelsight_without("run", "drive", "--odometry", "wheels", "--out", "out", "--force")
    assert done.exit_code == 0, done.output
    assert "no page is drawn: plotly is missing (pip install plotly)" in " ".join(done.stderr.split())
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"trajectory.txt", "covariances.csv", "status.csv", "metrics.json", "config.yaml"}
    assert "report" not in done.stdout
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["evaluation"] is not None


@pytest.mark.parametrize(
    ("arguments", "library"),
    [
        (("train", "drive", "--out", "new.places"), "scikit-learn"),
        (("predict", "a.places", "drive", "--out", "new.csv"), "skops"),
    ],
)
def test_places_say_what_to_install(
    wheelsight_without: Callable[..., Result], tmp_path: Path, arguments: tuple[str, ...], library: str
) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "a.places").write_bytes(b"")
    done = wheelsight_without("places", *arguments)
    assert done.exit_code == 2
    assert f"{library} is missing (pip install scikit-learn skops)" in " ".join(done.stderr.split())
    assert len(list(tmp_path.iterdir())) == 2


def test_what_is_installed_is_handed_out() -> None:
    assert needed("sklearn.ensemble").RandomForestClassifier.__name__ == "RandomForestClassifier"
    assert why_missing("plotly") is None


@pytest.mark.parametrize(
    ("module", "reported"),
    [
        ("skops.io", "skops is missing (pip install scikit-learn skops)"),
        ("plotly.subplots", "plotly is missing (pip install plotly)"),
        ("skimage.measure", "scikit-image is missing (pip install scikit-image)"),
        ("mujoco", "MuJoCo is missing (pip install mujoco matplotlib)"),
        ("cyclonedds.core", "Cyclone DDS is missing (pip install cyclonedds rosbags)"),
        ("zenoh", "Zenoh is missing (pip install eclipse-zenoh rosbags)"),
    ],
)
def test_what_is_missing_is_reported(module: str, reported: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError) as missing:
        needed(module)
    assert str(missing.value) == reported
