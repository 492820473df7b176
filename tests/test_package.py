"""The package's front door: light to import, sorted, complete; and what its parts declare."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

import wheelsight

HEAVY = ("cv2", "matplotlib", "numba", "open3d", "pandas", "plotly", "pydantic", "rich", "scipy", "typer", "yaml")
PACKAGES = sorted(
    f"wheelsight.{path.parent.relative_to(Path(wheelsight.__file__).parent).as_posix().replace('/', '.')}".rstrip(".")
    for path in Path(wheelsight.__file__).parent.rglob("__init__.py")
)


def run_python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_importing_wheelsight_loads_nothing_heavy() -> None:
    loaded = json.loads(run_python("import wheelsight, json, sys; print(json.dumps(sorted(sys.modules)))"))
    assert not {name.partition(".")[0] for name in loaded} & set(HEAVY)


@pytest.mark.parametrize("name", wheelsight.__all__)
def test_every_public_name_can_be_had(name: str) -> None:
    assert getattr(wheelsight, name) is not None


def test_each_public_name_is_the_object_of_its_module() -> None:
    for name, module in wheelsight._MODULE_OF.items():  # noqa: SLF001 - the package's own table
        assert getattr(wheelsight, name) is getattr(importlib.import_module(f"wheelsight.{module}"), name)


def test_the_lazy_names_are_the_public_names() -> None:
    lazy = {*wheelsight._MODULE_OF, "__version__"}  # noqa: SLF001 - the package's own table
    assert lazy == set(wheelsight.__all__) == set(dir(wheelsight))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = wheelsight.nonsense


def test_the_documentation_lists_every_public_name(project_folder: Path) -> None:
    listed = (project_folder / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in listed for name in wheelsight.__all__ if name != "__version__")


@pytest.mark.parametrize("package", PACKAGES)
def test_all_is_sorted_and_true(package: str) -> None:
    module = importlib.import_module(package)
    assert module.__doc__
    # Constants first, as ruff sorts.
    assert list(module.__all__) == sorted(set(module.__all__), key=lambda name: (not name.isupper(), name))
    assert all(hasattr(module, name) for name in module.__all__)


def test_the_version_is_the_installed_one() -> None:
    from importlib.metadata import version

    assert version("wheelsight") == wheelsight.__version__
