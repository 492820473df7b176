"""Writes OctoMap's binary trees with its own library, octomap-python, which must be installed."""

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
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.runtime import needed
from wheelsight.slam.maps import in_largest_piece


def export_octomap(
    source: Exported, path: StrPath, voxel_m: float, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> int:
    """Write the map's keyframes as an OctoMap (.bt) with cells of `voxel_m`, z up. Returns the number of keyframes.

    Rays of each depth image mark the space before a surface as free.

    Raises:
        ConfigError: octomap-python is not installed.
        InputError: there is no readable map.
        OutputError: the file cannot be written.
    """
    octomap, path = needed("octomap"), Path(path)
    check_name(path)
    kept = source.need_map()
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(in_largest_piece(kept))]
    if not numbers:
        raise MapError("has no keyframes that hang together", path=kept.path, fix="drive on, and export again")
    body = "camera" if kept.calibration.T_base_camera is None else "base"
    tree = octomap.OcTree(voxel_m)
    for done, number in enumerate(numbers, start=1):
        T_map_camera = kept.store.pose(number)
        # Points (N, 3) of a keyframe in its own frame, one a cell
        keyframe = kept.store[number]
        depth_m, (fx, fy, cx, cy) = keyframe.depth_m, keyframe.intrinsics
        v, u = np.nonzero(depth_m)
        z = depth_m[v, u].astype(float)
        p_keyframe = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
        seen = thinned(ColoredPoints(p_keyframe, np.zeros((len(p_keyframe), 3), np.uint8)), voxel_m).p_map
        p = upright_points(se3.apply(T_map_camera, seen), body)
        eye = upright_points(T_map_camera[None, :3, 3], body)[0]
        tree.insertPointCloud(np.ascontiguousarray(p), np.ascontiguousarray(eye))
        on_keyframe(done, len(numbers))
    # Whole or not at all; the library takes names alone
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        if not tree.writeBinary(os.fsencode(temporary)):
            raise OutputError("OctoMap could not write it", path=path, fix="check the folder and the room on the disk")
        temporary.replace(path)
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return len(numbers)
