"""Settings of surfels: kernels read each as it is set."""

from __future__ import annotations

import numpy as np
import pytest
from mapping.scenes import GRID, SHAPE, Wall, look_at, made_map, pose

from wheelsight.mapping import fusion_kernels as match
from wheelsight.mapping import view_kernels as view

# Of each number that kernels read, another one that shows.
CHANGED = {
    "stable_confidence": 3.0,
    "most_confidence": 2.0,
    "gone_confidence": 20.0,
    "color_frames": 0.5,
    "most_readings": 1.0,
    "averaged_sigmas": 0.0,
    "laid_sigmas": 0.0,
    "gate_sigmas": 0.5,
    "gate_m": 0.0,
    "max_angle_deg": 1.0,
    "max_slant_deg": 30.0,
    "least_cosine": 0.95,
    "disk_cosine": 0.95,
    "fine_enough": 1.0,
    "gap_m": 0.2,
    "free_m": 1.5,
    "free_sigmas": 50.0,
    "drift_m": 1.5,
    "blend": 0.8,
    "blend_m": 1.0,
    "smallest_px": 3.0,
    "largest_px": 1.0,
    "shown_cosine": 0.9,
}


def outcome(**settings: float) -> list[np.ndarray]:
    """A map of walls that meet, hide each other or stand aslant, seen on a way; one goes away. And a view of it."""
    rng = np.random.default_rng(4)
    rest = [
        Wall(3.0, 0.5, low=-0.6),
        Wall(3.0, 0.2, low=-0.6),
        Wall(4.25, high=-0.8),
        Wall(1.0, 1.5, low=0.2, high=0.8),
    ]
    subject = made_map(**{"far_m": 4.0, "stable_confidence": 4.0, "active_s": 0.2} | settings)
    way = [pose(x=0.06 * k, z=0.03 * k, yaw=0.02 * k) for k in range(8)]
    look_at(subject, [Wall(2.3, 0.1, high=-0.1), *rest], way, rng)
    look_at(subject, rest, way[::-1], rng, start_s=0.4)
    seen = subject.predict(way[2], GRID, SHAPE)
    surfels = subject.surfels()
    return [surfels.position, surfels.radius_m, surfels.confidence, surfels.color, seen.depth_m, seen.grey]


@pytest.fixture(scope="module")
def usual() -> list[np.ndarray]:
    return outcome()


@pytest.mark.parametrize("name", CHANGED)
def test_each_setting_that_kernels_read_shows_in_the_map(usual: list[np.ndarray], name: str) -> None:
    changed = outcome(**{name: CHANGED[name]})
    assert any(not np.array_equal(one, other) for one, other in zip(usual, changed, strict=True))


def test_all_that_kernels_read_is_tried() -> None:
    reckoned = {"min_normal_dot", "min_cosine", "laid_m", "least_cosine2"}
    rules = set(match.Rules._fields) - reckoned - {"far_m"}
    assert rules | {"max_angle_deg", "max_slant_deg", "laid_sigmas", "least_cosine"} <= CHANGED.keys()
    shown = {"smallest_px", "largest_px", "blend", "blend_m"}
    assert shown & (set(view.Limits._fields) | set(view.Image._fields)) == shown
    assert shown | {"shown_cosine"} <= CHANGED.keys()
