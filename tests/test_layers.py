"""Each part of wheelsight imports only what stands above it in the design's list."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from sources import BESIDE, imports_in

PACKAGE = Path(__file__).resolve().parent.parent / "wheelsight"
LAYERS = (
    "_version",
    "core",
    "evaluation",
    "io",
    "wheels",
    "vision",
    "places",
    "mapping",
    "slam",
    "navigation",
    "config",
    "estimation",
    "app",
    "__main__",
)
SOURCES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def imports_of(source: str) -> Iterator[tuple[int, str]]:
    """Line and full name of everything imported, inside functions and TYPE_CHECKING blocks too."""
    for node in imports_in(source):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        else:
            assert node.level == 0, f"line {node.lineno}: relative import; write the whole name"
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def layer_of(name: str) -> str | None:
    """The layer a dotted name belongs to, "" for wheelsight's own top, None for other packages."""
    package, *rest = name.split(".")
    if package != "wheelsight":
        return None
    return "_version" if rest == ["__version__"] else (rest or [""])[0]


def wrong_imports(source: str, layer: str) -> list[str]:
    """A line for each import in `source`, a module of `layer`, that does not stand above it."""
    allowed = LAYERS[: LAYERS.index(layer) + 1]
    return [
        f"line {line}: {layer} must not import {name}"
        for line, name in imports_of(source)
        if layer_of(name) is not None and layer_of(name) not in allowed
    ]


def test_the_page_on_architecture_names_the_layers_in_their_order() -> None:
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", page.partition("| part |")[2], re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`(\w+)`", row)]
    assert named == [name for name in LAYERS if not name.startswith("_")]


def module_of(path: Path) -> str:
    """Its dotted name; a package's is that of its `__init__`."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def circle_in(sources: Mapping[str, str]) -> list[str]:
    """Modules, by name with their text, that import each other in a circle, the first one again at the end; or none."""
    graph = {name: {_module_named(found, sources) for _, found in imports_of(text)} for name, text in sources.items()}
    try:
        TopologicalSorter({name: found - {None, name} for name, found in graph.items()}).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []


def _module_named(name: str, sources: Mapping[str, str]) -> str | None:
    """The module that an imported name is, or is a part of."""
    while name and name not in sources:
        name = name.rpartition(".")[0]
    return name or None


def layer_of_file(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def test_a_module_imports_only_what_stands_above_it() -> None:
    assert {layer_of_file(path) for path in SOURCES} <= set(LAYERS), "a new part needs its place in the list"
    assert [
        f"{path.relative_to(PACKAGE)}: {wrong}"
        for path in SOURCES
        for wrong in wrong_imports(path.read_text(encoding="utf-8"), layer_of_file(path))
    ] == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    sources = {module_of(path): path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    assert " imports ".join(circle_in(sources)) == ""


@pytest.mark.parametrize(
    "back",
    [
        "from wheelsight.places import model",
        "import wheelsight.places.model",
        "from wheelsight.places.model import PlaceModel",
        "def later():\n    from wheelsight.places.model import PlaceModel",
        "if TYPE_CHECKING:\n    from wheelsight.places.model import PlaceModel",
    ],
)
def test_a_circle_is_found(back: str) -> None:
    there = "from wheelsight.places.forest import grow"
    sources = {"wheelsight.places": "", "wheelsight.places.model": there, "wheelsight.places.forest": "import numpy"}
    assert circle_in(sources) == []
    sources["wheelsight.places.forest"] = back
    found = circle_in(sources)
    assert found[0] == found[-1]
    assert set(found) == {"wheelsight.places.model", "wheelsight.places.forest"}


# Parts of wheelsight that load a package beside it: applications alone, but for localizers of papers.
USERS = {"wheelsight_papers": {"app", "estimation"}}


@pytest.mark.parametrize("beside", BESIDE)
def test_a_package_beside_is_loaded_by_the_applications_alone(beside: str) -> None:
    users = {
        path.relative_to(PACKAGE).parts[0]
        for path in SOURCES
        for _, name in imports_of(path.read_text(encoding="utf-8"))
        if name.partition(".")[0] == beside
    }
    assert users <= USERS.get(beside, {"app"})


def test_the_simulator_knows_no_application() -> None:
    used = {
        name
        for path in (PACKAGE.parent / "wheelsight_sim").rglob("*.py")
        for _, name in imports_of(path.read_text(encoding="utf-8"))
        if layer_of(name) == "app" or name.partition(".")[0] in {*BESIDE} - {"wheelsight_sim"}
    }
    assert used == set()


@pytest.mark.parametrize(
    "source",
    [
        "from wheelsight.app.cli import main",
        "import wheelsight.vision.features",
        "def later():\n    from wheelsight import app",
        "if TYPE_CHECKING:\n    from wheelsight.app.run.records import RunRecord",
        "from wheelsight import Trajectory",
        "import wheelsight",
    ],
)
def test_the_check_finds_what_is_forbidden(source: str) -> None:
    assert len(wrong_imports(source, "io")) == 1


def test_the_check_allows_what_stands_above() -> None:
    source = "import numpy\nfrom wheelsight import __version__\nfrom wheelsight.core.geometry import se3\n"
    assert not wrong_imports(source, "io")
