"""Profiles: settings that go together for one kind of computer; what a user names lies over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, slots=True)
class ProfileSetting:
    """What a profile has in place of a default.

    Attributes:
        value: of the setting.
        why: it is so, with its unit where the setting's name has none.
        source: where the value comes from.
    """

    value: Any
    why: str
    source: str


_MEASURED = "three real recordings on one core: docs/decisions/0087"
_RECKONED = "reckoned; no recording here is long enough to show it"

PI: Mapping[str, ProfileSetting] = MappingProxyType(
    {
        "localizer.most_width_px": ProfileSetting(320, "images of 640×480 become 320×240", _MEASURED),
        "dense.finest_width_px": ProfileSetting(
            200, "the finest level is half of that, as by default it is half of 640: 160×120", _MEASURED
        ),
        "dense.keyframe_overlap": ProfileSetting(
            0.6, "about half as many keyframes, which must be compressed, recognised and kept", _MEASURED
        ),
        "dense.keyframe_way_m": ProfileSetting(0.5, "likewise beside a map, metres", _MEASURED),
        "features.keypoints": ProfileSetting(
            700, "as an image of a quarter of the pixels shows; with 500 one of three erred more", _MEASURED
        ),
        "features.candidates": ProfileSetting(1400, "twice as many, as by default", _MEASURED),
        "features.keyframe_share": ProfileSetting(0.35, "a third fewer keyframes", _MEASURED),
        "features.local_keyframes": ProfileSetting(12, "a smaller local map to search", _MEASURED),
        "surfels.fused_way_m": ProfileSetting(
            0.08, "twice as far between two frames that are fused, metres", _MEASURED
        ),
        "surfels.fused_after_s": ProfileSetting(0.2, "and twice as long, seconds", _MEASURED),
        "surfels.max_surfels": ProfileSetting(
            500_000, "36 MB; a quarter of the pixels lays about a quarter of the surfels", _RECKONED
        ),
        "navigation.mppi.rollouts": ProfileSetting(500, "a command in a quarter of the time", _MEASURED),
    }
)
PROFILES: Mapping[str, Mapping[str, ProfileSetting]] = MappingProxyType({"pi": PI})


def over_profile(profile: object, given: Mapping[str, Any]) -> dict[str, Any]:
    """Nested settings over those of a profile; as they are where there is none of that name."""
    below: dict[str, Any] = {}
    for name, of_profile in PROFILES.get(profile, {}).items() if isinstance(profile, str) else ():
        *sections, last = name.split(".")
        inner = below
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = of_profile.value
    return _over(below, given)


def differing(settings: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Of nested settings those that are not the same in others, which have the same names."""
    told: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping) and isinstance(others[name], Mapping):
            told |= {name: inner} if (inner := differing(value, others[name])) else {}
        elif value != others[name]:
            told[name] = value
    return told


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Nested mappings, in which those of `above` win."""
    both = {name for name in above if isinstance(below.get(name), Mapping) and isinstance(above[name], Mapping)}
    return {**below, **above, **{name: _over(below[name], above[name]) for name in both}}
