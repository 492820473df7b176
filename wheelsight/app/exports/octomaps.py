"""OctoMap's binary trees, by its own library through octomap-python, which must be there."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from wheelsight.app.exports.sources import ColoredPoints, Exported, thinned, upright_points
from wheelsight.core.errors import MapError, OutputError
from wheelsight.core.files import StrPath, check_name, output_error
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.core.runtime import needed
from wheelsight.slam.maps import lie_together


def export_octomap(
    source: Exported, path: StrPath, voxel_m: float, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> int:
    """Write the map's keyframes as an OctoMap (.bt) of cells of `voxel_m`, z up; how many keyframes went in.

    Each depth image is cast as rays: what lies before a surface becomes free.

    Raises:
        ConfigError: octomap-python is not installed.
        InputError: there is no map, or it cannot be read.
        OutputError: the file cannot be written.
    """
    octomap, path = needed("octomap"), Path(path)
    check_name(path)
    kept = source.need_map()
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(lie_together(kept))]
    if not numbers:
        raise MapError("has no keyframes that hang together", path=kept.path, fix="drive on, and export again")
    body = "camera" if kept.calibration.T_base_camera is None else "base"
    tree = octomap.OcTree(voxel_m)
    for done, number in enumerate(numbers, start=1):
        T_map_camera = kept.store.pose(number)
        p = upright_points(se3.apply(T_map_camera, _seen(kept.store[number], voxel_m)), body)
        eye = upright_points(T_map_camera[None, :3, 3], body)[0]
        tree.insertPointCloud(np.ascontiguousarray(p), np.ascontiguousarray(eye))
        on_keyframe(done, len(numbers))
    _write(tree, path)
    return len(numbers)


def _seen(keyframe: Keyframe, voxel_m: float) -> FloatArray:
    """Points (N, 3) of a keyframe in its own frame, one a cell."""
    depth_m, (fx, fy, cx, cy) = keyframe.depth_m, keyframe.intrinsics
    v, u = np.nonzero(depth_m)
    z = depth_m[v, u].astype(float)
    p = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
    return thinned(ColoredPoints(p, np.zeros((len(p), 3), np.uint8)), voxel_m).p_map


def _write(tree: object, path: Path) -> None:
    """Whole or not at all; the library takes names alone."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        if not tree.writeBinary(os.fsencode(temporary)):  # type: ignore[attr-defined]
            raise OutputError("OctoMap could not write it", path=path, fix="check the folder and the room on the disk")
        temporary.replace(path)
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
