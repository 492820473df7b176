"""Cells under a footprint and distances from it, against clipping in plain Python and shapely."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from navigation.floors import CHAIR, costmap_of
from navigation.plain_polygons import cells_under, placed
from odometry.plain_kernels import plain

from wheelsight.navigation import Footprint, PlannerSettings
from wheelsight.navigation import costmap_kernels as kernels
from wheelsight.navigation.path_smoothing import Drivable

PENTAGON = Footprint.of([(0.5, 0.0), (0.2, 0.35), (-0.3, 0.3), (-0.3, -0.3), (0.2, -0.35)])
ANGLES = st.floats(-np.pi, np.pi)
WIDTHS = st.floats(0.9, 3.1)


def drivable(seed: int, share: float = 0.03) -> Drivable:
    is_occupied = np.random.default_rng(seed).random((80, 80)) < share
    return Drivable.of(costmap_of(is_occupied), CHAIR, PlannerSettings())


@given(st.integers(0, 10**6), WIDTHS, WIDTHS, ANGLES, st.sampled_from([CHAIR, PENTAGON]))
def test_cells_under_a_footprint_are_those_that_clipping_finds(
    seed: int, x: float, y: float, yaw: float, footprint: Footprint
) -> None:
    made = drivable(seed, 0.2)
    found = kernels.count_under(made.cells, footprint.corners, x, y, yaw)
    # Of slivers rounding decides.
    outlines = footprint.padded(-1e-7).corners, footprint.padded(1e-7).corners
    least, most = (
        cells_under(made.costmap.is_lethal, 0.05, (0.0, 0.0), corners, (x, y, yaw), 1e-12) for corners in outlines
    )
    assert least <= found <= most


def test_what_only_touches_is_not_under_it() -> None:
    is_occupied = np.ones((40, 40), bool)
    is_occupied[10:22, 10:32] = False
    made = Drivable.of(costmap_of(is_occupied), CHAIR, PlannerSettings())
    # A hole of just 1.1 × 0.6 m; a hair more in any direction is too much.
    x, y = 0.5 + 0.3, 0.5 + 0.3
    assert kernels.count_under(made.cells, CHAIR.corners, x, y, 0.0) == 0
    for dx, dy, turn in ((1e-5, 0, 0), (-1e-5, 0, 0), (0, 1e-5, 0), (0, -1e-5, 0), (0, 0, 1e-3)):
        assert kernels.count_under(made.cells, CHAIR.corners, x + dx, y + dy, turn) > 0


def test_beyond_the_cells_nothing_is_free() -> None:
    made = drivable(1, 0.0)
    assert kernels.count_under(made.cells, CHAIR.corners, 0.31, 2.0, 0.0) == 0
    for pose in ((0.29, 2.0, 0.0), (3.3, 2.0, 0.0), (2.0, 0.2, 0.0), (2.0, 3.8, 0.0), (np.nan, 2.0, 0.0)):
        assert kernels.count_under(made.cells, CHAIR.corners, *pose) == kernels.OUTSIDE


@given(st.integers(0, 10**6), st.floats(0.3, 3.7), st.floats(0.3, 3.7), ANGLES)
def test_tightness_is_that_of_the_widest_outline_that_is_free(seed: int, x: float, y: float, yaw: float) -> None:
    """Whatever shortcuts are taken by distance."""
    made = drivable(seed, 0.004)
    under = [kernels.count_under(made.cells, outline, x, y, yaw) for outline in made.shape.outlines]
    shares = np.linspace(0, 1, len(under))
    expected = min((share for share, count in zip(shares, under, strict=True) if count == 0), default=np.inf)
    assert kernels.tightness(made.cells, made.shape, x, y, yaw) == pytest.approx(expected)


@given(st.integers(0, 10**6), WIDTHS, WIDTHS, ANGLES)
def test_clearance_is_that_of_shapely(seed: int, x: float, y: float, yaw: float) -> None:
    made = drivable(seed, 0.005)
    outline = shapely.Polygon(placed(CHAIR.corners, (x, y, yaw)))
    rows, columns = np.nonzero(made.costmap.is_lethal)
    squares = shapely.box(0.05 * columns, 0.05 * rows, 0.05 * (columns + 1), 0.05 * (rows + 1))
    expected = min(0.5, float(shapely.distance(outline, squares).min(initial=np.inf)))
    found = kernels.least_clearance(made.cells, CHAIR.corners, np.array([[x, y, yaw]]), 0.5)
    assert found == pytest.approx(expected, abs=1e-6)


def test_compiled_and_plain_kernels_say_the_same(rng: np.random.Generator) -> None:
    made = drivable(3, 0.001)
    poses = np.c_[rng.uniform(0.2, 3.8, (60, 2)), rng.uniform(-4, 4, 60)]
    results = []
    for module in (kernels, plain(kernels)):
        counts, tight = [module.count_under(made.cells, CHAIR.corners, *pose) for pose in poses], np.empty(len(poses))
        module.tightnesses(made.cells, made.shape, poses, tight)
        apart = [module.least_clearance(made.cells, CHAIR.corners, pose[None], 0.5) for pose in poses]
        results.append((counts, tight, apart))
    for one, other in zip(*results, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    assert set(np.unique(results[0][1])) >= {0.0, np.inf}


def test_the_clearance_of_many_poses_is_the_least_of_them(rng: np.random.Generator) -> None:
    made = drivable(5, 0.0005)
    poses = np.c_[rng.uniform(0.9, 3.1, (40, 2)), rng.uniform(-4, 4, 40)]
    each = [kernels.least_clearance(made.cells, CHAIR.corners, pose[None], 0.5) for pose in poses]
    assert kernels.least_clearance(made.cells, CHAIR.corners, poses, 0.5) == pytest.approx(min(each))
    clear = poses[np.array(each) > 0]
    assert len(clear) > 2
    expected = min(one for one in each if one > 0)
    assert kernels.least_clearance(made.cells, CHAIR.corners, clear, 0.5) == pytest.approx(expected)
