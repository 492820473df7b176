from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sessions.kept_views import CALIBRATION, CAMERA

from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import MapError
from wheelsight.slam.maps import MapFolder


def test_a_map_of_another_camera_is_reported(written: Path) -> None:
    folder = MapFolder.open(written)
    folder.check_camera(Calibration.registered_camera(replace(CAMERA, fx=60.5)))
    wrong = {
        "its fx is 60.0 px, here 66.0": replace(CAMERA, fx=66.0),
        "its cy is 23.5 px, here 30.5": replace(CAMERA, cy=30.5),
        "its images are 64×48, these 32×24": replace(CAMERA, width=32, height=24, fx=30, fy=30, cx=15.5, cy=11.5),
    }
    for why, camera in wrong.items():
        with pytest.raises(MapError, match=rf"is of another camera: {why} \(give"):
            folder.check_camera(Calibration.registered_camera(camera))
    apart = Calibration(CAMERA, CAMERA, T_color_depth=np.eye(4))
    with pytest.raises(MapError, match="its depth is registered to colour, here it is not"):
        folder.check_camera(apart)


def test_another_depth_factor_is_reported(tmp_path: Path) -> None:
    MapFolder.create(tmp_path / "map", CALIBRATION, depth_factor=5000.0).close()
    folder = MapFolder.open(tmp_path / "map")
    folder.check_camera(CALIBRATION)  # no one says
    with pytest.raises(MapError, match="its depth factor is 5000, here 1000"):
        folder.check_camera(CALIBRATION, 1000.0)


@pytest.mark.parametrize(
    "wrong", [{"width": 0}, {"height": -1}, {"width": 1 << 20}, {"fx": 1e999}, {"depth_factor": 0}]
)
def test_a_camera_that_is_none_is_refused(copied: Path, wrong: dict[str, Any]) -> None:
    """Such as one of a million pixels' width, which would allow keyframes of any size."""
    header = MapFolder.open(copied).header
    replace(header, camera=replace(header.camera, **wrong)).save(copied)
    with pytest.raises(MapError, match=r"map\.json: is damaged"):
        MapFolder.open(copied)


def test_a_newer_map_is_refused_and_an_edited_one(copied: Path) -> None:
    path = copied / "map.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"version": 2}))
    with pytest.raises(MapError, match="is of version 2, newer than 1"):
        MapFolder.open(copied)
    path.write_text(json.dumps(document | {"source": "elsewhere"}))
    with pytest.raises(MapError, match="its checksum is wrong"):
        MapFolder.open(copied)
    path.write_text("{")
    with pytest.raises(MapError, match="is damaged"):
        MapFolder.open(copied)
    path.unlink()
    with pytest.raises(MapError, match="is no map"):
        MapFolder.open(copied)
