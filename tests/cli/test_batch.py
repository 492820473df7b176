"""Many recordings at the command line: one table, whatever breaks; and it goes on where it was ended."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from batch_jobs import until, write_wheels
from typer.testing import Result

from wheelsight.app.cli.console import console
from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import ENDING
from wheelsight_batch import BatchRow, Done, Outcome, Spread
from wheelsight_batch.cli import share
from wheelsight_batch.progress import BatchProgress, batch_table
from wheelsight_batch.table import csv_text, read_rows

Command = Callable[..., Result]


def plain(text: str) -> str:
    """As a person sees it, without colours."""
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Three recordings: with truth, without, and a broken one."""
    for name, has_truth in (("bend", True), ("blind", False), ("broken", True)):
        write_wheels(tmp_path / "data" / name, 120, has_truth=has_truth)
    (tmp_path / "data" / "broken" / "wheels.csv").write_text("stamp_s,left,right\n0.0,1,x\n")
    (tmp_path / "arc.yaml").write_text("odometry: wheels\n")
    (tmp_path / "euler.yaml").write_text("odometry: wheels\nwheels: {integration: euler}\n")
    return tmp_path / "data"


def arguments(data: Path, *configs: str) -> list[str]:
    named = [word for config in configs for word in ("--config", str(data.parent / f"{config}.yaml"))]
    return ["batch", str(data), *named, "--out", str(data.parent / "out"), "--jobs", "1"]


@pytest.mark.slow
def test_all_are_rows_of_one_table_and_what_is_done_is_not_run_again(wheelsight: Command, data: Path) -> None:
    result = wheelsight(*arguments(data, "arc", "euler"), "--seeds", "3")
    assert result.exit_code == 2, result.output
    assert "2 of 6 rows" not in result.stdout
    assert "4 of 6 rows are whole" in result.stdout
    assert "broken, euler: broken: " in result.stdout
    assert "wheels.csv:2: right is 'x'" in result.stderr
    assert "4 of 6 rows have nothing random, and are run once" in result.stderr
    rows = {(row.recording, row.config): row for row in read_rows(data.parent / "out" / "table.csv")}
    assert rows["bend", "arc"].figures["ate_m"].median < 1e-6
    assert rows["bend", "euler"].figures["rpe_m"].median > 1e-4
    assert "ate_m" not in rows["blind", "arc"].figures
    assert rows["blind", "arc"].figures["tracked"] == Spread(1.0, 1.0)
    assert rows["broken", "arc"].status == "broken"
    done = {path: path.stat().st_mtime_ns for path in (data.parent / "out" / "jobs").iterdir()}
    assert len(done) == 4
    write_wheels(data / "another", 50)
    assert wheelsight(*arguments(data, "arc")).exit_code == 2
    after = {path: path.stat().st_mtime_ns for path in (data.parent / "out" / "jobs").iterdir()}
    assert len(after) == 5
    assert done.items() <= after.items()
    assert not list((data.parent / "out").glob(".scratch*"))


@pytest.mark.slow
def test_what_is_worse_than_the_baseline_is_named_with_code_1(wheelsight: Command, data: Path) -> None:
    bend, out = str(data / "bend"), data.parent / "out"
    good = ["batch", bend, "--config", str(data.parent / "arc.yaml"), "--out", str(out), "--jobs", "1"]
    assert wheelsight(*good).exit_code == 0
    (row,) = read_rows(out / "table.csv")
    baseline = data.parent / "baseline.csv"
    baseline.write_text((out / "table.csv").read_text())
    same = wheelsight(*good, "--baseline", baseline)
    assert same.exit_code == 0
    assert "1 rows held against the baseline, 10 % allowed: none of their figures worse" in same.stdout
    better = {**row.figures, "frame_ms": Spread(1e-9, 1e-9)}
    baseline.write_text(csv_text([BatchRow("bend", "arc", "wheels", 1, "ok", "", better)]))
    assert wheelsight(*good, "--baseline", baseline).exit_code == 0
    slower = wheelsight(*good, "--baseline", baseline, "--cost-tolerance", "50%")
    assert slower.exit_code == 1
    assert "worse: bend, arc: ms median " in slower.stdout
    baseline.write_text(csv_text([BatchRow("other", "arc", "wheels", 1, "ok", "", better)]))
    assert "the baseline has none of these" in wheelsight(*good, "--baseline", baseline).stderr


@pytest.mark.slow
@pytest.mark.parametrize("ended_by", [signal.SIGKILL, signal.SIGINT])
def test_a_batch_that_was_ended_goes_on(ended_by: signal.Signals, wheelsight: Command, data: Path) -> None:
    for number in range(4):
        write_wheels(data / f"drive{number}", 3000 + number)  # some tenths of a second each
    words, done = arguments(data, "arc"), data.parent / "out" / "jobs"

    def listening() -> None:
        for number in ENDING:
            signal.signal(number, signal.SIG_DFL)

    command = [sys.executable, "-m", "wheelsight", *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ, preexec_fn=listening) as process:
        until(lambda: done.is_dir() and any(done.glob("*.json")))
        process.send_signal(ended_by)
        _, reported = process.communicate()
    assert process.returncode == (128 + ended_by if ended_by in ENDING else -signal.SIGKILL)
    assert ("interrupted; what is done is kept" in reported) is (ended_by in ENDING)
    kept = {path: path.stat().st_mtime_ns for path in done.glob("*.json")}
    assert 0 < len(kept) < 6
    assert not (data.parent / "out" / "table.csv").exists()
    until(lambda: not list((data.parent / "out").glob(".scratch*")))
    assert "6 of 7 rows are whole" in wheelsight(*words).stdout
    after = {path: path.stat().st_mtime_ns for path in done.glob("*.json")}
    assert len(after) == 6
    assert kept.items() <= after.items()


def test_what_is_wrong_is_one_line(refusal: Command, data: Path) -> None:
    out = ("--out", data.parent / "out")
    assert "--tolerance is much, not a share" in str(refusal("batch", data, *out, "--tolerance", "much"))
    assert "nothing fits" in str(refusal("batch", f"{data}/none*", *out))
    assert "cannot be read" in str(refusal("batch", data, *out, "--baseline", data / "none.csv"))
    assert "no table of a batch" in str(refusal("batch", data, *out, "--baseline", data / "bend" / "wheels.csv"))
    assert not (data.parent / "out").exists()
    (data.parent / "out").mkdir()
    (data.parent / "out" / "mine.txt").write_text("")
    assert "is not empty" in str(refusal("batch", data, *out))


@pytest.mark.parametrize(("text", "value"), [("10%", 0.1), ("0.25", 0.25), ("0", 0.0), ("200 %", 2.0)])
def test_shares(text: str, value: float) -> None:
    assert share(text, "--tolerance") == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "nan", "-1", "ten", "inf%"])
def test_no_shares(text: str) -> None:
    with pytest.raises(ConfigError, match="not a share"):
        share(text, "--tolerance")


def test_the_table_fits_80_columns(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    figures = {"ate_m": Spread(0.1234, 12.5), "rpe_m": Spread(0.01, 0.02), "rpe_deg": Spread(1.5, 100.25)}
    figures |= {"tracked": Spread(1.0, 0.995), "frame_ms": Spread(36.9, 123.45), "memory_mb": Spread(812.0, 12345.0)}
    name = "rgbd_dataset_freiburg1_desk_with_a_long_name"
    rows = [BatchRow(name, "dense-with-loops", "dense", 5, "2 of 5 broken", "killed", figures)]
    console().print(batch_table(rows), soft_wrap=False)
    lines = plain(capsys.readouterr().out).splitlines()
    assert max(map(len, lines)) <= 80
    text = "\n".join(lines)
    for reported in ("0.1234", "12.5000", "100.250", "99.5", "36.90", "123.45", "812", "12345", "rgbd_data", "dense-"):
        assert reported in text
    assert "lower line: worst" in text


@pytest.mark.parametrize("columns", [60, 80])
def test_progress_has_count_rate_and_time_left(
    columns: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    now_s = [1000.0]
    monkeypatch.setattr("wheelsight_batch.progress.time.monotonic", lambda: now_s[0])
    with BatchProgress() as progress:
        progress.show(Done(10, 20, 0, 100, None, None))
        now_s[0] += 60
        progress.show(Done(11, 20, 25, 100, Outcome("a", "broke"), None))
        progress.warn("a: broke")
    reported = plain(capfd.readouterr().err)
    assert "warning: a: broke" in reported
    last = [line for line in reported.replace("\r", "\n").splitlines() if "11/20 jobs" in line][-1]
    assert "1.0 jobs/min" in last
    assert "3:00 left" in last
    assert "1 br" in last
