"""The lowest versions that pyproject.toml allows, as what pip is to install: `python tests/lowest_versions.py`."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"
# What users install. The other extras are made of these, or serve the work on the project.
OF_USERS = (
    "report",
    "places",
    "sim",
    "mesh",
    "bags",
    "realsense",
    "mkv",
    "web",
    "rerun",
    "foxglove",
    "ros2",
    "fleet",
    "slam",
)
# What the tests run by, in any version: gtsam asks for a pytest that is newer than our lowest.
OF_TESTS = (
    "httpx",
    "hypothesis",
    "mcap",
    "mcap-ros1-support",
    "mcap-ros2-support",
    "pytest",
    "pytest-timeout",
    "pytest-xdist",
)
# Such as "uvicorn>=0.35.0", "mkdocstrings[python]>=0.29", "gtsam>=4.3.0; sys_platform != 'win32'".
_BOUND = re.compile(r"^(?P<name>[\w.-]+)(\[[\w,.-]+\])?>=(?P<version>\d+(\.\w+)*)\s*(;\s*(?P<marker>.+))?$")


def lowest(requirements: Iterable[str]) -> dict[str, str]:
    """Each name with its lowest version, such as "numpy==2.0.0"; wheelsight's own extras have none.

    Raises ValueError for a requirement without a lower bound, or with another bound.
    """
    found = {}
    for requirement in requirements:
        if requirement.startswith("wheelsight["):
            continue
        if (bound := _BOUND.match(requirement)) is None:
            raise ValueError(f"{requirement!r} does not say from which version on (name>=version)")
        marker = f" ; {bound['marker']}" if bound["marker"] else ""
        found[bound["name"]] = f"{bound['name']}=={bound['version']}{marker}"
    return found


def requirements_of(project: Mapping[str, Any], extras: Sequence[str]) -> list[str]:
    """Of the package without an extra, and of some of its extras; each once."""
    of_extras = (name for extra in extras for name in project["optional-dependencies"][extra])
    return list(dict.fromkeys([*project["dependencies"], *of_extras]))


def project_of(path: Path = PYPROJECT) -> dict[str, Any]:
    """The table `project`."""
    with path.open("rb") as file:
        return dict(tomllib.load(file)["project"])


def main() -> None:
    """Print a line each of what users install, then of what the tests need besides."""
    lines = lowest(requirements_of(project_of(), OF_USERS)).values()
    sys.stdout.writelines(f"{line}\n" for line in (*lines, *OF_TESTS))


if __name__ == "__main__":
    main()
