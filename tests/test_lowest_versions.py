"""Each dependency says from which version on it works; `make lowest` tries these versions."""

from __future__ import annotations

import sys

import lowest_versions
import pytest
from lowest_versions import OF_TESTS, OF_USERS, lowest, project_of, requirements_of

PROJECT = project_of()
# Made of the others, or for work on the project.
NOT_OF_USERS = {"papers", "bench", "docs", "dev"}


def test_every_extra_is_tried_or_known_to_be_no_users() -> None:
    assert {*OF_USERS, *NOT_OF_USERS} == set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize("extra", ["", *PROJECT["optional-dependencies"]])
def test_every_dependency_has_a_lower_bound(extra: str) -> None:
    requirements = PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]
    own = [requirement for requirement in requirements if requirement.startswith("wheelsight[")]
    assert len(lowest(requirements)) == len(requirements) - len(own)


def test_the_list_is_pyprojects_own(capsys: pytest.CaptureFixture[str]) -> None:
    lowest_versions.main()
    lines = capsys.readouterr().out.splitlines()
    stated = requirements_of(PROJECT, OF_USERS)
    assert [line.replace("==", ">=").replace(" ;", ";") for line in lines[: len(stated)]] == stated
    assert lines[len(stated) :] == list(OF_TESTS)
    of_dev = " ".join(PROJECT["optional-dependencies"]["dev"])
    assert [name for name in OF_TESTS if f"{name}>=" not in of_dev] == []


@pytest.mark.parametrize("requirement", ["numpy", "numpy<3", "numpy==2.0.0", "numpy~=2.0", "numpy>=2.0,<3", "numpy>=x"])
def test_what_says_no_lowest_version_is_refused(requirement: str) -> None:
    with pytest.raises(ValueError, match="does not say from which version on"):
        lowest([requirement])


def test_a_bound_becomes_that_version() -> None:
    assert lowest(
        ["opencv-python-headless>=4.14.0.94", "gtsam>=4.3.0; sys_platform != 'win32'", "wheelsight[sim]"]
    ) == {
        "opencv-python-headless": "opencv-python-headless==4.14.0.94",
        "gtsam": "gtsam==4.3.0 ; sys_platform != 'win32'",
    }


def test_the_oldest_python_is_the_one_that_is_stated() -> None:
    oldest = tuple(map(int, PROJECT["requires-python"].removeprefix(">=").split(".")))
    assert oldest <= sys.version_info[:2]
