"""Libraries that an extra of wheelsight brings: loaded when they are needed, and named with the extra where missing."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from wheelsight.errors import ConfigError

# By the name that is imported: the library's, and the extra that brings it.
_EXTRAS = {
    "plotly": ("plotly", "report"),
    "sklearn": ("scikit-learn", "places"),
    "skops": ("skops", "places"),
}


def needed(module: str) -> Any:
    """A module of a library that an extra brings, such as "skops.io".

    Raises:
        ConfigError: the library is not installed; says how to install it.
    """
    library, extra = _EXTRAS[module.partition(".")[0]]
    try:
        return import_module(module)
    except ImportError as error:
        raise ConfigError(f"{library} is missing", fix=f'pip install "wheelsight[{extra}]"') from error


def why_missing(library: str) -> str | None:
    """What to say of a library of an extra, by the name that is imported; None where it is installed."""
    try:
        needed(library)
    except ConfigError as error:
        return str(error)
    return None
