"""Map files as wheelsight wrote them before, made of a map of today."""

from __future__ import annotations

import json
import math
import zlib

import numpy as np

from wheelsight.mapping import SurfelMap

_FIELDS = (
    ("position", "<f4", 3),
    ("normal", "<f4", 3),
    ("radius_m", "<f4", 0),
    ("color", "<f4", 3),
    ("grey", "<f4", 0),
    ("confidence", "<f4", 0),
    ("variance_m2", "<f4", 0),
    ("first_s", "<f8", 0),
    ("last_s", "<f8", 0),
    ("keyframe", "<i4", 0),
)


def second_version(surfel_map: SurfelMap) -> bytes:
    """Before surfels were compressed."""
    surfels = surfel_map.surfels()
    order = np.lexsort(surfels.position.T)
    arrays = [np.ascontiguousarray(getattr(surfels, name)[order], dtype) for name, dtype, _ in _FIELDS]
    body = b"".join(array.tobytes() for array in (*arrays, surfel_map.T_map_keyframe.astype("<f8")))
    header = {
        "frame": "map",
        "surfels": len(surfels.grey),
        "fields": [list(field) for field in _FIELDS],
        "keyframes": len(surfel_map.T_map_keyframe),
        "stamp_s": surfel_map.stamp_s if math.isfinite(surfel_map.stamp_s) else None,
        "dropped": surfel_map.dropped,
        "crc32": zlib.crc32(body),
        "settings": surfel_map.settings.model_dump(),
    }
    return f"wheelsight-map-2\n{json.dumps(header)}\n".encode() + body


def first_version(data: bytes) -> bytes:
    """A file of the second version before surfels hung on keyframes."""
    _, header, body = data.split(b"\n", 2)
    about = json.loads(header)
    numbers = body[: len(body) - 128 * about.pop("keyframes") - 4 * about["surfels"]]
    del about["frame"], about["fields"][-1]
    about["crc32"] = zlib.crc32(numbers)
    return b"\n".join([b"wheelsight-map-1", json.dumps(about).encode(), numbers])
