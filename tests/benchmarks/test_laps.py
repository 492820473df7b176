"""Loops against the truth, and which keyframes see a place again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import laps
from benchmarks.laps_surface import share_within, surface_of
from benchmarks.table import Sheet, write_page
from wheelsight.core.errors import InputError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.slam.graph import RelativePose
from wheelsight_sim import SimulationSettings, simulate

# x of a camera that looks along z is to its right; it stands upright in a world whose z is up.
LOOKS_ALONG_X = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
DRIVE = laps.Laps("flat", "joined", 1, 40.0, 1.0, 0.2, 0.1, 10, 2, 0, 1, 8, 6)


def at(x: float, y: float, yaw: float = 0.0) -> np.ndarray:
    return np.asarray(se3.from_plane(x, y, yaw) @ LOOKS_ALONG_X)


@pytest.mark.parametrize(
    ("off", "is_right"),
    [
        (np.zeros(6), True),
        (np.array([0.4, 0, 0, 0, 0, 0]), True),
        (np.array([0.6, 0, 0, 0, 0, 0]), False),
        (np.array([0, 0, 0, 0, 0.2, 0]), False),
    ],
)
def test_a_loop_is_false_that_is_far_off(off: np.ndarray, is_right: bool) -> None:
    ends = np.stack([at(1.0, 2.0, 0.3), at(1.5, 2.2, 0.4)])
    reported = se3.exp(off) @ se3.invert(ends[0]) @ ends[1]
    sure, along = np.eye(6) * 0.01**2, np.diag([9.0, 1e-4, 1e-4, 1e-4, 9.0, 1e-4])
    assert laps.is_right(ends, RelativePose(KeyframeId(0), KeyframeId(1), reported, sure)) == is_right
    assert laps.is_right(ends, RelativePose(KeyframeId(0), KeyframeId(1), reported, along))


def test_a_revisit_is_near_looks_the_same_way_and_comes_later() -> None:
    stamps_s = np.array([0.0, 5.0, 30.0, 31.0, 32.0])
    cameras = np.stack([at(0, 0), at(0.1, 0), at(0.5, 0.5, 0.1), at(0.2, 0, np.pi), at(5, 0)])
    assert laps.revisits(stamps_s, cameras).tolist() == [False, False, True, False, False]


def test_targets_count_all_drives() -> None:
    other = replace(DRIVE, mode="camera alone", false=2, closed=1, end_m=0.3)
    false, closed, alone, joined = laps.judge([DRIVE, other])
    assert (false.measured, closed.measured) == (2, 100 * 7 / 16)
    assert alone.measured == pytest.approx(1.5)
    assert joined.measured == pytest.approx(0.5)
    assert DRIVE.row[0] == "flat, seed 1, joined"
    assert DRIVE.row[-2:] == ("6/8", "—")
    assert replace(DRIVE, surfels_near=0.9).row[-1] == "90.0 %"


def test_a_page_has_what_was_measured_on_what_and_the_tables(tmp_path: Path) -> None:
    sheet = Sheet("Laps", ("drive", "closed"), (("flat", "6/8"),))
    write_page(tmp_path / "page.md", "Two laps", "What they are.", {"Date": "today", "Images": "320×240"}, [sheet])
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert page.startswith("# Two laps\n\nWhat they are.\n- Date: today\n- Images: 320×240\n\n## Laps\n")
    assert "| flat | 6/8 |" in page


def test_a_drive_that_is_kept_is_not_measured_again_nor_taken_for_another(tmp_path: Path) -> None:
    kept = laps.Kept(tmp_path / "drives", {"laps": 2, "rate_hz": 10.0, "way_m": 40.0})
    assert kept.of("flat", "joined", 1) is None
    kept.keep(DRIVE)
    assert kept.of("flat", "joined", 1) == DRIVE
    assert kept.of("flat", "joined", 2) is None
    with pytest.raises(InputError, match="measured otherwise"):
        laps.Kept(tmp_path / "drives", {"laps": 3, "rate_hz": 10.0, "way_m": 40.0}).of("flat", "joined", 1)
    laps.Kept(None, {}).keep(DRIVE)
    assert laps.Kept(None, {}).of("flat", "joined", 1) is None


def test_surfels_are_held_against_what_the_camera_truly_saw() -> None:
    source = simulate(SimulationSettings(world="square", size=(64, 48), rate_hz=3.0, duration_s=2.0))
    surface = surface_of(source)
    T_world_map = se3.from_plane(1.0, 2.0, 0.5)
    R, t = T_world_map[:3, :3], T_world_map[:3, 3]
    seen = (surface.points[surface.was_seen] - t) @ R
    assert share_within(seen, T_world_map, surface) == 1.0
    mounted_wrongly = se3.exp([0.03, -0.02, 0.02, 0.01, 0.0, 0.01]) @ T_world_map
    assert share_within(seen, mounted_wrongly, surface) > 0.98
    rng = np.random.default_rng(0)
    blurred = seen + 0.1 * rng.normal(size=(len(seen), 1)) * surface.normals[surface.was_seen] @ R
    assert share_within(blurred, T_world_map, surface) < 0.4
    assert np.isnan(share_within(seen[:0], T_world_map, surface))
