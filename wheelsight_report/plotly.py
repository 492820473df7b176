"""plotly's figures, loaded when the first one is drawn: text and tables of a report do not need it.

Stands for `plotly.graph_objects`. Any use raises ConfigError where plotly is not installed.
"""

from __future__ import annotations

from typing import Any

from wheelsight.core.runtime import needed


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    return getattr(needed("plotly.graph_objects"), name)


def make_subplots(**layout: Any) -> Any:
    """As `plotly.subplots.make_subplots`."""
    return needed("plotly.subplots").make_subplots(**layout)
