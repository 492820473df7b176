"""The map as points that a reader turns: what the page holds of it, and the picture for who cannot."""

from __future__ import annotations

import json
from html import escape

import numpy as np

from wheelsight.geometry import FloatArray
from wheelsight.mapping.cloud import MapCloud
from wheelsight.pipeline import words
from wheelsight.pipeline.map_record import MapRecord
from wheelsight.pipeline.run_record import RunRecord
from wheelsight.report import _series as series
from wheelsight.report._packing import packed
from wheelsight.report.cloud_view import View, draw_cloud
from wheelsight.report.pictures import webp_uri

_MOST_LOOPS = 400
_MOST_STEPS = 2000
_LEVELS = 2**16 - 1
_NORMAL_LEVELS = 127


def figure(record: RunRecord, key: str) -> str:
    """The map's points with path and loops, as HTML; nothing of a map without points."""
    found = record.map
    if found is None or found.cloud is None or found.plan is None:
        return ""
    R = found.plan.R_plan_map
    position = found.cloud.position.astype(float) @ R.T
    path, loops = path_steps(record) @ R.T, loop_steps(record) @ R.T
    view = View.of(position, path.reshape(-1, 3))
    still = webp_uri(draw_cloud(view, position, found.cloud, R, path, loops))
    counts = {"points": len(position), "path": len(path), "loops": len(loops)}
    low, step_m = _box(position)
    told = counts | {"edge": round(found.cloud.edge_m, 5), "low": low.tolist(), "step": step_m} | view.to_dict()
    alt = f"{len(position):,} points of the map, seen aslant from above, with the path."
    return (
        f"<figure>\n<figcaption><strong>To be turned.</strong> {escape(_sentence(found, len(loops)))}</figcaption>\n"
        f'<div class="cloud" id="{key}-cloud" data-cloud="{escape(json.dumps(told))}">'
        f'<img src="{still}" alt="{escape(alt)}"><canvas tabindex="0" role="img" aria-label="{escape(alt)}"></canvas>'
        f'</div><script type="text/plain">{packed(_bytes(position, found.cloud, R, path, loops))}</script>\n</figure>'
    )


def path_steps(record: RunRecord) -> FloatArray:
    """(m, 2, 3) steps of the way in the map, none over a gap; as known at the end where loops were closed."""
    way = record.estimate if record.correction is None else record.correction.found.corrected
    _, path = series.with_gaps(way.stamps_s, way.positions_m, series.poseless_stamps_s(record))
    path = path[series.keep_shape(path, _MOST_STEPS)]
    steps = np.stack([path[:-1], path[1:]], axis=1)
    return np.asarray(steps[~np.isnan(steps).any(axis=(1, 2))])


def loop_steps(record: RunRecord) -> FloatArray:
    """(k, 2, 3) lines between the ends of loops that were kept, in the map; evenly picked where there are too many."""
    if record.correction is None:
        return np.zeros((0, 2, 3))
    found = record.correction.found
    ends = np.array([(loop.first, loop.second) for loop in found.loops.kept], np.int64).reshape(-1, 2)
    return np.asarray(found.T_map_keyframe[ends[:: max(1, -(-len(ends) // _MOST_LOOPS))], :3, 3])


def _sentence(found: MapRecord, loops: int) -> str:
    cloud = found.cloud
    assert cloud is not None
    kind = "stable surfels" if found.status.stable else "surfels"
    text = f"{len(cloud):,} points"
    if cloud.edge_m:
        text += f": the {cloud.of:,} {kind}, averaged in cubes of {words.length(cloud.edge_m)}"
    else:
        text += f", each one of the {kind}"
    text += ". Surfaces are seen from their front alone, so that one looks into rooms. The orange line is the path"
    text += "; green lines join places that were recognised" if loops else ""
    return (
        f"{text}. Drag to turn, with shift to move; two fingers zoom and move; the wheel zooms once the figure was "
        "clicked. Keys: arrows, with shift to move; + and −; Home."
    )


def _box(position: FloatArray) -> tuple[FloatArray, float]:
    """The lowest corner, and how much a level of 16 bits is."""
    return np.round(position.min(axis=0), 4), max(float(np.ptp(position, axis=0).max()), 1e-3) / (_LEVELS - 1)


def _bytes(position: FloatArray, cloud: MapCloud, R: FloatArray, path: FloatArray, loops: FloatArray) -> bytes:
    """Lines as float32; then x, y, z in 16 bits, red, green, blue, and normals in 8, each less the one before."""
    low, step_m = _box(position)
    level = np.rint((position - low) / step_m).clip(0, _LEVELS).astype("<u2")
    normal = np.rint(_NORMAL_LEVELS * (cloud.normal.astype(float) @ R.T)).astype(np.int8).view(np.uint8)
    lines = np.concatenate([path, loops]).astype("<f4").tobytes()
    planes = (np.diff(plane.T, axis=1, prepend=plane.T[:, :1] * 0) for plane in (level, cloud.color, normal))
    return lines + b"".join(np.ascontiguousarray(plane).tobytes() for plane in planes)
