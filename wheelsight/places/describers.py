"""The describers there are, by what saved models call them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from wheelsight.errors import PlaceError
from wheelsight.places.describer import Describer
from wheelsight.places.histograms import HistogramDescriber, HistogramSettings
from wheelsight.places.layout import LayoutDescriber, LayoutSettings


def describer_from(settings: Mapping[str, Any]) -> Describer:
    """The describer that has these `settings`.

    Raises:
        PlaceError: its kind is not known, or a setting is unknown or impossible.
    """
    others = {name: value for name, value in settings.items() if name != "kind"}
    try:
        if settings.get("kind") == HistogramDescriber.kind:
            return HistogramDescriber(HistogramSettings.model_validate(others))
        if settings.get("kind") == LayoutDescriber.kind:
            return LayoutDescriber(LayoutSettings.model_validate(others))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise PlaceError(f"description setting {where}: {first['msg']}", fix="train the model again") from error
    fix = f"known: {HistogramDescriber.kind}, {LayoutDescriber.kind}"
    raise PlaceError(f"no description is called {settings.get('kind')!r}", fix=fix)
