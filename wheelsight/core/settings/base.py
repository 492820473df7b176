"""`Settings`, the base class of all settings, and `setting`, a field with bounds, reason and source.
`checked_settings` validates values from files. `split_removed` finds names that only earlier versions had.
`PROFILES` holds sets of values for one kind of computer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from json import loads
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from wheelsight.core.errors import InputError

# Sources of defaults.
ON_SIMULATOR = "found on the simulator alone"
CHOSEN = "chosen; no measurement"
ASKED = "for the user to say"


class Settings(BaseModel):
    """A section of `Config`: frozen; without unknown names, and numbers that are not finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def setting(default: Any, why: str, source: str, **bounds: Any) -> Any:
    """Return a field of a settings class.

    Args:
        default: `...` if it is required.
        why: effect of the setting and reason of its default; with its unit if its name has none.
        source: of the default: its computation, or the drives that showed it.
        bounds: of pydantic's `Field`: gt, ge, lt, le, and min_length, max_length of several values.
    """
    return Field(default=default, description=why, json_schema_extra={"source": source}, **bounds)


def bounds(**limits: Any) -> Any:
    """Return bounds, as in `setting`, of each of several numbers: `tuple[Annotated[float, bounds(gt=0)], ...]`."""
    return Field(**limits)


def conflict(name: str, problem: str, fix: str) -> PydanticCustomError:
    """Return the error of settings that are valid alone but conflict, for a validator.

    Args:
        name: the wrong setting, dotted, from the class that refuses it.
        problem: after the name.
        fix: in the message.
    """
    return PydanticCustomError(
        "conflict", "{setting} {problem} ({fix})", {"setting": name, "problem": problem, "fix": fix}
    )


_CONFLICT = "conflict"
_Settings = TypeVar("_Settings", bound=BaseModel)


@dataclass(frozen=True, slots=True, eq=False)
class SettingFault:
    """The first wrong setting of a model.

    Attributes:
        location: names of its sections, and its own; empty for a conflict between settings.
        known: names of the settings in the same section.
        details: pydantic's.
    """

    location: tuple[str, ...]
    known: tuple[str, ...]
    details: dict[str, Any]

    @classmethod
    def of(cls, invalid: ValidationError, model: type[BaseModel]) -> SettingFault:
        """Return the first fault of a validation by `model`."""
        details: dict[str, Any] = dict(invalid.errors(include_url=False)[0])
        location = tuple(part for part in details["loc"] if isinstance(part, str))  # a setting, not its place in a list
        if details["type"] == _CONFLICT:
            location += tuple(details["ctx"]["setting"].split("."))
        section: Any = model
        for part in location[:-1]:
            field = getattr(section, "model_fields", {}).get(part)
            kinds = () if field is None else (*get_args(field.annotation), field.annotation)
            section = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
        return cls(location, tuple(sorted(getattr(section, "model_fields", {}))), details)

    def message(self, name: str | None = None) -> tuple[str, str | None]:
        """Return the problem of the setting, by this `name`, and its fix or None."""
        details, name = self.details, ".".join(self.location) if name is None else name
        if details["type"] == _CONFLICT:
            return f"{name} {details['ctx']['problem']}", details["ctx"]["fix"]
        if details["type"] == "extra_forbidden":
            near = get_close_matches(self.location[-1], self.known, n=1)
            return f"unknown setting {name}", f"did you mean {near[0]}?" if near else f"known: {', '.join(self.known)}"
        if details["type"] == "missing":
            return f"{name} is missing", None
        if details["type"] == "literal_error":
            return f"{name} is {details['input']!r}", f"known: {details['ctx']['expected']}"
        message = details["msg"].removeprefix("Value error, ").removeprefix("Input ")
        return f"{name} is {details['input']!r}, which {message}" if name else message, None


def checked_settings(
    model: type[_Settings], values: Any, error: type[InputError], whose: str, fix: str | None = None
) -> _Settings:
    """Return the validated settings of a file.

    Args:
        model: type of the settings.
        values: names and values in the file.
        error: raised for invalid settings.
        whose: begin of the message, such as "settings: ".
        fix: replaces the fix of the fault.
    """
    try:
        return model.model_validate(values)
    except ValidationError as invalid:
        problem, right = SettingFault.of(invalid, model).message()
        raise error(f"{whose}{problem}", fix=fix or right) from invalid


REMOVED_FILE = Path(__file__).with_name("removed.txt")
"""Settings of earlier versions, one a line: `features.cell_px = 64` (a constant now) or `places.x -> places.y`."""


class RemovedSetting(NamedTuple):
    """A name in a file that only earlier versions have.

    Attributes:
        name: dotted, from `Config`.
        value: in the file.
        fixed: JSON text of the constant in its place, or None.
        renamed: the new name, or None.
    """

    name: str
    value: Any
    fixed: str | None = None
    renamed: str | None = None

    @property
    def problem(self) -> str:
        """What became of it, as it follows the name in a message."""
        if self.renamed is not None:
            return f"is now {self.renamed}"
        return "is no longer a setting" + ("" if self.fixed in (None, "null") else f": it is fixed at {self.fixed}")

    @property
    def fix(self) -> str:
        """What to do with its line."""
        return "remove the line" if self.renamed is None else "rename it"

    @property
    def differs(self) -> bool:
        """Whether the value in the file is not the constant, and is lost."""
        return self.fixed is not None and self.value != loads(self.fixed)


def split_removed(values: Mapping[str, Any], section: str = "") -> tuple[dict[str, Any], list[RemovedSetting]]:
    """Return nested settings with current names, and the removed settings in their order.

    Args:
        values: names and values of a file.
        section: dotted name of the section that they belong to; empty for the whole `Config`.
    """
    known, found = _removed_settings(REMOVED_FILE), list[RemovedSetting]()

    def without(values: Mapping[str, Any], prefix: str) -> dict[str, Any]:
        kept = dict[str, Any]()
        for name, value in values.items():
            line = known.get(dotted := f"{prefix}{name}")
            if line is not None:
                found.append(line._replace(value=value))
            elif not isinstance(value, Mapping):
                kept[name] = value
            elif (inner := without(value, f"{dotted}.")) or not value:
                kept[name] = inner
        return kept

    prefix = f"{section}." if section else ""
    kept = without(values, prefix)
    for one in found:
        if one.renamed is not None:
            kept = _over(_nested(one.renamed.removeprefix(prefix), one.value), kept)
    return kept, found


@cache
def _removed_settings(path: Path) -> Mapping[str, RemovedSetting]:
    lines = dict[str, RemovedSetting]()
    for line in path.read_text(encoding="utf-8").splitlines():
        name, sign, rest = line.split(" ", 2)
        lines[name] = RemovedSetting(name, None, **{"renamed" if sign == "->" else "fixed": rest})
    return lines


@dataclass(frozen=True, slots=True)
class ProfileSetting:
    """A default in a profile, for one kind of computer.

    Attributes:
        value: of the setting.
        why: reason, with the unit if the setting's name has none.
        source: of the value.
    """

    value: Any
    why: str
    source: str


_MEASURED = "three real recordings on one core: docs/decisions/package-and-speed.md"
_COMPUTED = "computed; no recording here is long enough to show it"

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
            500_000, "36 MB; a quarter of the pixels lays about a quarter of the surfels", _COMPUTED
        ),
        "navigation.mppi.rollouts": ProfileSetting(500, "a command in a quarter of the time", _MEASURED),
    }
)
PROFILES: Mapping[str, Mapping[str, ProfileSetting]] = MappingProxyType({"pi": PI})


def over_profile(profile: object, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested settings over those of a profile; unchanged for an unknown profile."""
    below: dict[str, Any] = {}
    for name, of_profile in PROFILES.get(profile, {}).items() if isinstance(profile, str) else ():
        below = _over(below, _nested(name, of_profile.value))
    return _over(below, given)


def differing(settings: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return the nested settings that differ from others with the same names."""
    changed: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping) and isinstance(others[name], Mapping):
            changed |= {name: inner} if (inner := differing(value, others[name])) else {}
        elif value != others[name]:
            changed[name] = value
    return changed


def _nested(name: str, value: Any) -> dict[str, Any]:
    """The value under a dotted name."""
    for part in reversed(name.split(".")):
        value = {part: value}
    return dict(value)


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested mappings; values of `above` win."""
    both = {name for name in above if isinstance(below.get(name), Mapping) and isinstance(above[name], Mapping)}
    return {**below, **above, **{name: _over(below[name], above[name]) for name in both}}
