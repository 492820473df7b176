"""The package's front door: light to import, sorted, complete; and what its parts declare."""

from __future__ import annotations

import importlib
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import sources
from sources import ROOT

import wheelsight

IMPORTED_AS = {"scikit-image": "skimage", "scikit-learn": "sklearn"}
# Parts without a page of their own: users type the command line, readers use inputs, the page on geometry shows each
# module, and worlds are chosen by their names.
NO_PAGE = (
    "wheelsight",
    "wheelsight.app.cli",
    "wheelsight.core.inputs",
    "wheelsight.core.geometry",
    "wheelsight_sim.worlds",
)
PACKAGES = sorted(
    path.parent.relative_to(ROOT).as_posix().replace("/", ".")
    for folder in (ROOT / name for name in sources.PACKAGES)
    for path in folder.rglob("__init__.py")
)


def run_python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_importing_wheelsight_loads_nothing_but_itself() -> None:
    reported = run_python("import sys; before = {*sys.modules}; import wheelsight; print(*({*sys.modules} - before))")
    loaded = {name for name in reported.split() if name.partition(".")[0] not in sys.stdlib_module_names}
    assert loaded == {"wheelsight", "wheelsight._version"}


def test_every_public_name_can_be_had_without_the_extras(project_folder: Path) -> None:
    extras = tomllib.loads((project_folder / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = [one for name, needed in extras.items() if name not in ("bench", "dev", "docs") for one in needed]
    missing = [IMPORTED_AS.get(name, name) for name in (re.split(r"[<>=;\[]", one)[0] for one in wanted)]
    missing = [name for name in missing if name != "wheelsight"]  # an extra may take another along
    assert "mujoco" in missing
    run_python(
        f"import sys\nsys.modules.update(dict.fromkeys({missing}))\n"
        "import wheelsight\nfor name in wheelsight.__all__: getattr(wheelsight, name)"
    )


@pytest.mark.parametrize("name", wheelsight.__all__)
def test_every_public_name_can_be_had(name: str) -> None:
    assert getattr(wheelsight, name) is not None


def test_each_public_name_is_the_object_of_its_module() -> None:
    for name, module in wheelsight._MODULE_OF.items():  # noqa: SLF001 - the package's own table
        assert getattr(wheelsight, name) is getattr(importlib.import_module(module), name)


def test_the_lazy_names_are_the_public_names() -> None:
    lazy = {*wheelsight._MODULE_OF, "__version__"}  # noqa: SLF001 - the package's own table
    assert lazy == set(wheelsight.__all__) == set(dir(wheelsight))


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = wheelsight.nonsense


def test_the_documentation_lists_every_public_name(project_folder: Path) -> None:
    listed = (project_folder / "docs" / "api" / "index.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in listed for name in wheelsight.__all__ if name != "__version__")


@pytest.mark.parametrize("package", [package for package in PACKAGES if package not in NO_PAGE])
def test_the_api_pages_show_every_part(package: str, project_folder: Path) -> None:
    pages = (project_folder / "docs" / "api").glob("*.md")
    shown = {line.removeprefix("::: ") for page in pages for line in page.read_text(encoding="utf-8").splitlines()}
    module = importlib.import_module(package)
    # Where a name is that of its module, too, the page of the package finds the module and leaves the name out.
    hidden = [name for name in module.__all__ if importlib.util.find_spec(f"{package}.{name}") is not None]
    assert {f"{package}.{name}.{name}" for name in hidden} <= shown
    assert package in shown or not module.__all__


def test_members_that_the_api_pages_list_are_there(project_folder: Path) -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in (project_folder / "docs" / "api").glob("*.md"))
    listed = re.findall(r"^::: ([\w.]+)\n    options:\n      members:\n((?:        - \w+\n)+)", text, re.MULTILINE)
    names = [(module, name) for module, lines in listed for name in re.findall(r"\w+", lines)]
    assert len(names) > 50
    assert [pair for pair in names if not hasattr(importlib.import_module(pair[0]), pair[1])] == []


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
