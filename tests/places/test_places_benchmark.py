"""The benchmark of places: areas from poses, its tables, and limits that can fail."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import places
from wheelsight.core.geometry import se3
from wheelsight.core.trajectory import Trajectory
from wheelsight.places import HistogramDescriber, HistogramSettings

TIMES = places.PlaceTimes("histograms", 0.3, 0.4, 8.0, 2.0)


def test_poses_apart_are_areas_apart(rng):
    where = np.repeat([[0.0, 0, 0], [5, 0, 0], [0, 5, 0]], 20, axis=0) + 0.1 * rng.standard_normal((60, 3))
    T = se3.exp(np.hstack([where, np.zeros((60, 3))]))
    labels = places.areas_by_clustering(Trajectory(np.arange(60.0), T), 3)
    assert [len(set(labels[i : i + 20])) for i in (0, 20, 40)] == [1, 1, 1]
    assert len(set(labels)) == 3


def test_looking_elsewhere_is_another_area():
    turned = se3.exp([0, 0, 0, 0, np.pi / 2, 0])
    T = np.concatenate([np.tile(np.eye(4), (10, 1, 1)), np.tile(turned, (10, 1, 1))])
    labels = places.areas_by_clustering(Trajectory(np.arange(20.0), T), 2)
    np.testing.assert_array_equal(labels == labels[0], np.arange(20) < 10)


def test_limits_can_be_missed():
    assert all(target.is_met for target in places.judge_places([TIMES]))
    changes: list[dict[str, Any]] = [{"predict_ms": 1.1}, {"plain_ms": 1.9}, {"training_s": 5.1}]
    for change in changes:
        verdicts = [target.is_met for target in places.judge_places([replace(TIMES, **change)])]
        assert verdicts.count(False) == 1


def test_the_tables_hold_what_was_measured():
    accuracy = places.RealAccuracy("kitchen", "first 60 %", "layout", 4, 3, 0.1, 0.91, 0.88, 0.5, 0.99, 0.07, 0.9)
    table = places.places_sheet([TIMES]).to_markdown() + places.accuracy_sheet([accuracy]).to_markdown()
    assert "| histograms | 0.30 | 0.40 | 8.0 | 20× | 2.0 |" in table
    assert "| kitchen | first 60 % | layout | 4 | 3 | 0.10 | 0.91 | 0.88 | 0.50 | 0.99 | 0.07 |" in table


@pytest.mark.slow
@pytest.mark.data
def test_real_frames_are_named_better_than_by_guessing(data_folder: Path):
    """A bound that chance and a constant answer miss; the figures themselves are in the benchmark."""
    describer = HistogramDescriber(HistogramSettings())
    *_, alternately = places.measure_real(data_folder / "rgbd" / "red_kitchen", [describer])
    assert alternately.tested_areas == alternately.areas == 6
    assert alternately.unseen == 0
    assert alternately.accuracy > 0.6
