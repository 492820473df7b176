"""Settings: what all settings classes share, and `setting`, a field that says where its default comes from."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

# Sources of defaults: one that no real drive has confirmed, and one of which no measurement is recorded.
ON_SIMULATOR = "found on the simulator alone"
CHOSEN = "chosen; no measurement"
# Of what only a user knows.
ASKED = "what nobody has asked for otherwise"


class Settings(BaseModel):
    """A section of `Config`: frozen; unknown names and numbers that are not finite are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def setting(default: Any, why: str, source: str, **bounds: Any) -> Any:
    """A field of a settings class.

    Args:
        default: its value where nobody says otherwise; `...` where somebody must.
        why: what it does and why it is so large; with its unit, where its name has none.
        source: of the default: what it was reckoned from, or which drives showed it.
        bounds: as pydantic's `Field` takes them: gt, ge, lt, le, and min_length, max_length of several.
    """
    return Field(default=default, description=why, json_schema_extra={"source": source}, **bounds)


def bounds(**limits: Any) -> Any:
    """Of each of several numbers: `tuple[Annotated[float, bounds(gt=0, le=10)], ...]`; named as those of `setting`."""
    return Field(**limits)


def conflict(name: str, problem: str, fix: str) -> PydanticCustomError:
    """Of settings each of which is sound; for a validator to raise where they meet.

    Args:
        name: the setting at fault, dotted, seen from the class that refuses it.
        problem: what is wrong, as it follows the name.
        fix: what to do.
    """
    return PydanticCustomError(
        "conflict", "{setting} {problem} ({fix})", {"setting": name, "problem": problem, "fix": fix}
    )
