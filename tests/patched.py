"""Constants of the package that have another value in all tests of a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest


def patched(constants: Mapping[str, object], package: str = "wheelsight.navigation") -> Any:
    """Return a fixture that sets constants by their dotted names within a package; assign it to a name of the file."""

    @pytest.fixture(autouse=True)
    def constants_of_this_file(monkeypatch: pytest.MonkeyPatch) -> None:
        for name, value in constants.items():
            monkeypatch.setattr(f"{package}.{name}", value)

    return constants_of_this_file
