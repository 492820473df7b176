"""The benchmark of batches: recordings that are jobs of their own, and a verdict that is right."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from benchmarks import batch
from wheelsight_batch import plan_of


def test_each_copy_is_a_job(tmp_path: Path) -> None:
    (tmp_path / "joined.yaml").write_text(batch.SETTINGS)
    paths = batch.write_recordings(tmp_path / "data", 3, 0.5)
    plan = plan_of(paths, [tmp_path / "joined.yaml"], 1)
    assert [case.problem for case in plan.cases] == [None] * 3
    assert len(plan.jobs) == 3


@pytest.mark.parametrize(("two_s", "verdict"), [(10.0, "met"), (10.6, "missed by 0.01 times (1 %)")])
def test_the_verdict(two_s: float, verdict: str) -> None:
    passes = [batch.Pass(1, 20, 20.0, 20.0, 1.0), batch.Pass(2, 20, two_s, 20.0, 1.0)]
    sheets = batch.sheets_of(passes)
    assert sheets[1].rows[0][-1] == verdict
    assert sheets[0].rows[0] == ("1", "20", "20.0", "20.0", "1.0")


def test_cores_are_held_for_a_while_only() -> None:
    usual = os.sched_getaffinity(0)
    with batch.held_to(1):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == usual
