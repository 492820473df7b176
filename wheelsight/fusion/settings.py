"""FusionSettings: by which filter sensors are joined, and all that the filters go by."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from wheelsight.fusion.areas import AreaRectifierSettings
from wheelsight.fusion.error_state import ErrorStateSettings
from wheelsight.fusion.ligocki import LigockiSettings

FusionName = Literal["default", "ligocki", "none"]


class FusionSettings(BaseModel):
    """Settings of all filters; a name alone says which one joins."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    filter: FusionName = Field(
        default="none",
        description="how wheels and one camera odometry are joined: by the default filter, which is the default where "
        "both are named, by Ligocki's, or not at all",
    )
    error_state: ErrorStateSettings = ErrorStateSettings()
    areas: AreaRectifierSettings = AreaRectifierSettings()
    ligocki: LigockiSettings = LigockiSettings()

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        return {"filter": given} if isinstance(given, str) else given
