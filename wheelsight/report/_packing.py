"""What a page holds besides text, made small: deflated and written in base64, numbers no finer than one can see."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np

# Of its extent: a figure 1000 px wide may be zoomed in a hundred times before such a rounding moves a line by a pixel.
_SEEN_SHARE = 1e-5


def packed(data: bytes) -> str:
    """`data` as the page's script unpacks it."""
    return base64.b64encode(zlib.compress(data, 9)).decode("ascii")


def lean_json(figure_json: str) -> str:
    """A plotly figure's JSON with its arrays in single precision, where nobody can see the difference."""
    return json.dumps(_lean(json.loads(figure_json)), separators=(",", ":"), ensure_ascii=False)


def _lean(value: Any) -> Any:
    if isinstance(value, list):
        return [_lean(part) for part in value]
    if not isinstance(value, dict):
        return value
    if value.get("dtype") == "f8":
        return _in_single_precision(value)
    return {name: _lean(part) for name, part in value.items()}


def _in_single_precision(array: dict[str, Any]) -> dict[str, Any]:
    wide = np.frombuffer(base64.b64decode(array["bdata"]), "<f8")
    known = wide[np.isfinite(wide)]
    if len(known) == 0 or abs(known).max() > np.finfo(np.float32).max:
        return array
    narrow = wide.astype("<f4")
    if abs(narrow[np.isfinite(wide)] - known).max() > _SEEN_SHARE * np.ptp(known):
        return array
    return {**array, "dtype": "f4", "bdata": base64.b64encode(narrow.tobytes()).decode("ascii")}
