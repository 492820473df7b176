"""A batch: what is done is kept and not run again; what breaks is not."""

from __future__ import annotations

import json
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from batch_jobs import job, quick, write_wheels

from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.errors import OutputError
from wheelsight.io.recordings import open_recording
from wheelsight_batch import BatchPlan, Case, Done, Job, Outcome, plan_of, run_batch, run_job
from wheelsight_batch.jobs import problem_of

JOBS = {name: job(name, weight=size) for name, size in (("a", 3), ("b", 2), ("c", 1))}
PLAN = BatchPlan((Case("one", "x", "dense", ("a", "b")), Case("two", "x", "dense", ("c",))), JOBS)


class Runner:
    """Answers jobs here, and remembers them; some break, and one interrupts it."""

    def __init__(self, broken: str = "", stop_at: str = "") -> None:
        self.asked: list[str] = []
        self._broken, self._stop_at = broken, stop_at

    def __call__(self, jobs: Sequence[Job]) -> Generator[Outcome]:
        for one in jobs:
            if one.id == self._stop_at:
                raise KeyboardInterrupt
            self.asked.append(one.id)
            yield Outcome(one.id, "it broke") if one.id in self._broken else quick(one)


def test_what_was_done_before_an_interruption_is_not_run_again(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_batch(PLAN, tmp_path / "out", Runner(stop_at="c"))
    assert not (tmp_path / "out" / "table.csv").exists()
    rest, steps = Runner(), list[Done]()
    rows = run_batch(PLAN, tmp_path / "out", rest, steps.append)
    assert rest.asked == ["c"]
    assert [(step.jobs, step.of_jobs, step.weight, step.of_weight) for step in steps] == [(2, 3, 0, 1), (3, 3, 1, 1)]
    assert [row.status for row in rows] == ["ok", "ok"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"jobs", "table.csv", "table.md"}
    again = Runner()
    assert run_batch(PLAN, tmp_path / "out", again) == rows
    assert again.asked == []


def test_what_broke_is_run_again_and_what_is_torn_too(tmp_path: Path) -> None:
    rows = run_batch(PLAN, tmp_path, Runner(broken="b"))
    assert [row.status for row in rows] == ["1 of 2 broken", "ok"]
    (tmp_path / "jobs" / "a.json").write_text('{"version": 1, "outc')
    rest = Runner()
    assert [row.status for row in run_batch(PLAN, tmp_path, rest)] == ["ok", "ok"]
    assert rest.asked == ["a", "b"]


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty"):
        run_batch(PLAN, tmp_path, Runner())
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def planned(drive: Path, tmp_path: Path) -> Job:
    (tmp_path / "wheels.yaml").write_text("odometry: wheels\n")
    (made,) = plan_of([drive], [tmp_path / "wheels.yaml"], 1).jobs.values()
    return made


def test_a_job_finds_what_a_run_finds(tmp_path: Path) -> None:
    drive = write_wheels(tmp_path / "drive", 80)
    outcome = run_job(planned(drive, tmp_path))
    config = load_config(overrides={"odometry": "wheels"})
    (record,) = run_each(open_recording(drive), config, tmp_path / "run")
    assert outcome.problem is None
    assert record.evaluation is not None
    assert record.evaluation.rpe_per_second is not None
    assert outcome.figures["ate_m"] == record.evaluation.ate.translation.rmse
    assert outcome.figures["rpe_m"] == record.evaluation.rpe_per_second.translation.rmse
    assert outcome.figures["tracked"] == 1.0
    assert outcome.metrics["evaluation"] == json.loads((tmp_path / "run" / "metrics.json").read_text())["evaluation"]


def test_memory_is_of_the_job_and_not_of_those_before_it(tmp_path: Path) -> None:
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("only Linux forgets a peak of memory")
    made = planned(write_wheels(tmp_path / "drive", 80), tmp_path)
    usual = run_job(made).figures["memory_mb"]
    large = bytearray(b"1") * 400_000_000
    del large
    after = run_job(made).figures["memory_mb"]
    assert usual is not None
    assert after is not None
    assert after < usual + 200


def test_without_truth_there_is_no_ate_but_the_rest(tmp_path: Path) -> None:
    outcome = run_job(planned(write_wheels(tmp_path / "drive", 80, has_truth=False), tmp_path))
    assert outcome.problem is None
    assert [outcome.figures[name] for name in ("ate_m", "rpe_m", "rpe_deg")] == [None, None, None]
    assert outcome.figures["tracked"] == 1.0
    assert outcome.figures["frame_ms"] is not None


def test_the_joined_way_counts_where_sensors_are_joined() -> None:
    from wheelsight_batch.batches import figures_of

    own = {"evaluation": {"ate_m": {"rmse": 0.5}}, "frames": {"with_pose_share": 0.7}}
    own |= {"timing": {"frame_median_ms": 3.0}}
    metrics = {"odometry": {"joined": own, "wheels": {}}, "peak_memory_mb": 9.0}
    assert figures_of(metrics, "joined") == {
        "ate_m": 0.5, "rpe_m": None, "rpe_deg": None, "tracked": 0.7, "frame_ms": 3.0, "memory_mb": 9.0
    }  # fmt: skip


def test_a_job_of_another_wheelsight_is_refused_and_one_that_breaks_is_reported(tmp_path: Path) -> None:
    made = planned(write_wheels(tmp_path / "drive", 80), tmp_path)
    assert run_job(replace(made, code="another")).problem == (
        "this computer has another wheelsight (install the same on all of them)"
    )
    (tmp_path / "drive" / "wheels.csv").unlink()
    assert str(tmp_path / "drive") in (run_job(made).problem or "")


def test_reasons_are_one_line() -> None:
    assert problem_of(MemoryError()) == "memory ran out"
    assert problem_of(OSError(28, "No space left on device", "/data/x")) == "/data/x: No space left on device"
    assert problem_of(ValueError("two\nlines")) == "a bug: ValueError: two lines"
