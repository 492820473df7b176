"""The describers there are, by what saved models call them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from wheelsight.errors import PlaceError
from wheelsight.inputs.settings import checked_settings
from wheelsight.places.describer import Describer
from wheelsight.places.histograms import HistogramDescriber, HistogramSettings
from wheelsight.places.layout import LayoutDescriber, LayoutSettings


def describer_from(settings: Mapping[str, Any]) -> Describer:
    """The describer that has these `settings`.

    Raises:
        PlaceError: its kind is not known, or a setting is unknown or impossible.
    """
    others = {name: value for name, value in settings.items() if name != "kind"}
    whose, fix = "description settings: ", "train the model again"
    if settings.get("kind") == HistogramDescriber.kind:
        return HistogramDescriber(checked_settings(HistogramSettings, others, PlaceError, whose, fix))
    if settings.get("kind") == LayoutDescriber.kind:
        return LayoutDescriber(checked_settings(LayoutSettings, others, PlaceError, whose, fix))
    fix = f"known: {HistogramDescriber.kind}, {LayoutDescriber.kind}"
    raise PlaceError(f"no description is called {settings.get('kind')!r}", fix=fix)
