"""Calibrations laid over each other as they stand in their files: what the upper one tells stands, the rest stays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# One lens is not mixed with another's: who gives the colour camera gives all that its pixels mean.
_LENSES = ("color", "depth", "T_color_depth", "color_sigma_px", "depth_error", "point_errors")
_FIELD_BY_FIELD = ("wheels", "gyro", "depth_noise", "nominal")
# Of these parts a file may also hold what was known when the rest was found: it stands where nothing else tells it.
NOMINAL, NOMINAL_PARTS = "nominal", ("wheels", "gyro")
# What was measured when: of a file, not of a calibration.
HISTORY = "history"


def laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of `below` with those of `above` in their place.

    Wheels, gyro and depth noise are laid over field by field, so that the delay may come from one calibration and the
    radii from another; with `color` goes all that is told of lenses.
    """
    kept = {name: value for name, value in below.items() if "color" not in above or name not in _LENSES}
    merged = {**kept, **above}
    for name in _FIELD_BY_FIELD:
        parts = (below.get(name), above.get(name))
        if all(isinstance(part, Mapping) for part in parts) and not _are_of_other_kinds(*parts):
            merged[name] = {**parts[0], **parts[1]}  # type: ignore[dict-item]
    told = [entry for part in (below, above) for entry in part.get(HISTORY) or ()]
    if told:
        merged[HISTORY] = [entry for index, entry in enumerate(told) if entry not in told[:index]]
    source = _both_sources(below.get("source"), above.get("source"))
    return merged if source is None else {**merged, "source": source}


def _are_of_other_kinds(below: Any, above: Any) -> bool:
    """Whether the upper of two parts names a kind or layout of wheels that the lower one does not have."""
    usual = {"kind": "differential", "layout": None}
    return any(name in above and above[name] != below.get(name, usual[name]) for name in usual)


def _both_sources(below: Any, above: Any) -> Any:
    """Where the numbers come from; what is laid over twice is told once."""
    if below is None or above is None or below == above:
        return below if above is None else above
    earlier = [told for told in str(below).split(_UPDATED) if told != above]
    return _UPDATED.join([*earlier, str(above)])


_UPDATED = ", updated by: "
