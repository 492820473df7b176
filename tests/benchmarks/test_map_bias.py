"""Whether a map of true poses lies where surfaces are, and whether it would be noticed if it did not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.map_bias import Bias, bias_sheet, drives, measure_bias

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install '.[sim]'")


def test_sums_are_by_distance_and_leave_out_what_no_one_asked() -> None:
    true_m, asked = np.array([[1.5, 1.6, 4.2, 4.3]]), np.array([[True, True, True, False]])
    bias = Bias()
    bias.add(true_m, (true_m + 0.01, np.array([[1.48, 0.0, 4.25, 9.0]])), asked)
    np.testing.assert_allclose(bias.mean_m[:, [0, 3]], [[0.01, 0.01], [-0.02, 0.05]])
    np.testing.assert_array_equal(bias.answered[:, [0, 3]], [[2, 1], [1, 1]])
    assert np.isnan(bias.mean_m[:, 1]).all()
    assert bias_sheet("Floor", bias).rows[0] == ("1 to 2 m", "10.0 (100 %)", "-20.0 (50 %)")


@pytest.mark.slow
def test_a_map_of_true_poses_lies_where_surfaces_are() -> None:
    floor, rest = measure_bias(*drives("floor4", 6.0))
    assert np.abs(floor.mean_m[1, :4]).max() < 2e-3
    assert np.abs(rest.mean_m[1, 1:6]).max() < 4e-3
