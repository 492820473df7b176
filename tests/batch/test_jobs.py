"""Jobs: named by all that shapes their outcome; what cannot be run is a row with its reason."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from batch_jobs import write_wheels

from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError
from wheelsight_batch import jobs, named_recordings, plan_of
from wheelsight_batch.jobs import digest_of, is_random, short_names


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_wheels(tmp_path / "data" / "drive", 60)


@pytest.fixture
def by_wheels(tmp_path: Path) -> Path:
    path = tmp_path / "wheels.yaml"
    path.write_text("odometry: wheels\n")
    return path


def ids(drive: Path, config: Path, seeds: int = 1) -> tuple[str, ...]:
    (case,) = plan_of([drive], [config], seeds).cases
    assert case.problem is None
    return case.jobs


def test_a_job_has_its_name_of_what_shapes_its_outcome(
    drive: Path, by_wheels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = ids(drive, by_wheels)
    assert ids(drive, by_wheels) == first
    moved = Path(shutil.copytree(drive, tmp_path / "elsewhere" / "drive"))
    assert ids(moved, by_wheels) == first
    (tmp_path / "euler.yaml").write_text("odometry: wheels\nwheels: {integration: euler}\n")
    assert ids(drive, tmp_path / "euler.yaml") != first
    counts = (moved / "wheels.csv").read_text()
    (moved / "wheels.csv").write_text(counts.replace(",1770,", ",1771,"))
    assert ids(moved, by_wheels) != first
    monkeypatch.setattr(jobs, "code_digest", lambda: "another")
    assert ids(drive, by_wheels) != first


def test_a_file_that_settings_name_shapes_it_too(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(drive / "calibration.yaml", tmp_path / "mine.yaml")
    (tmp_path / "settings.yaml").write_text("odometry: wheels\nrecording: {calibration: mine.yaml}\n")
    plan = plan_of([drive], [Path("settings.yaml")], 1)
    (made,) = plan.jobs.values()
    assert made.settings["recording"]["calibration"] == str(tmp_path / "mine.yaml")
    text = (tmp_path / "mine.yaml").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("0.52", "0.53"))
    assert list(plan_of([drive], [Path("settings.yaml")], 1).jobs) != [made.id]


def test_large_files_are_compared_by_their_ends_their_middle_and_their_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wheelsight_batch.jobs._WHOLE_BYTES", 100)
    monkeypatch.setattr("wheelsight_batch.jobs._PIECE_BYTES", 10)
    path = tmp_path / "large"
    path.write_bytes(bytes(1000))
    os.utime(path, ns=(1, 1))
    first = digest_of(path)
    assert first.size == 1000
    for place in (3, 500, 995):
        changed = bytearray(1000)
        changed[place] = 1
        path.write_bytes(bytes(changed))
        os.utime(path, ns=(1, 1))
        assert digest_of(path) != first
    path.write_bytes(bytes(1000))
    assert digest_of(path) != first
    os.utime(path, ns=(1, 1))
    assert digest_of(path) == first


def test_seeds_are_of_what_is_random_alone() -> None:
    for reported, expected in (
        ({"odometry": "wheels"}, False),
        ({"odometry": "wheels,dense", "map": "surfels"}, False),
        ({"odometry": "features"}, True),
        ({"odometry": "wheels,features"}, True),
        ({"odometry": "dense", "loops.source": "keyframes"}, True),
    ):
        assert is_random(load_config(overrides=reported)) is expected
    seeded = list(jobs.seeded(load_config(overrides={"odometry": "features", "features.seed": 2**32 - 2}), 3))
    assert [(one.features.seed, one.recognition.seed) for one in seeded] == [(2**32 - 2, 0), (2**32 - 1, 1), (0, 2)]


def test_each_seed_is_a_job(room: Path, tmp_path: Path) -> None:
    by_features = tmp_path / "features.yaml"
    by_features.write_text("odometry: features\n")
    plan = plan_of([room], [by_features], 3)
    (case,) = plan.cases
    assert (case.recording, case.config, case.odometry, len(case.jobs)) == ("room", "features", "features", 3)
    assert {one.settings["features"]["seed"] for one in plan.jobs.values()} == {0, 1, 2}


def test_where_nothing_is_named_it_is_known_what_was_chosen(room: Path, drive: Path, by_wheels: Path) -> None:
    plan = plan_of([room, drive], [], 1)
    assert [case.chosen for case in plan.cases] == ["dense", "wheels"]
    assert [case.problem for case in plan.cases] == [None, None]
    (case,) = plan_of([drive], [by_wheels], 1).cases
    assert (case.chosen, case.odometry) == ("", "wheels")


def test_what_cannot_be_run_is_a_row_with_its_reason_and_the_rest_goes_on(
    drive: Path, by_wheels: Path, tmp_path: Path
) -> None:
    broken = write_wheels(tmp_path / "data" / "broken", 10)
    (broken / "wheels.csv").write_text("stamp_s,left,right\n0.0,1,x\n")
    (tmp_path / "surfels.yaml").write_text("map: surfels\n")
    plan = plan_of([broken, drive, tmp_path / "nowhere"], [by_wheels, tmp_path / "surfels.yaml"], 1)
    problems = {(case.recording, case.config): case.problem or "" for case in plan.cases}
    assert "wheels.csv:2: right is 'x'" in problems["broken", "wheels"]
    assert problems["drive", "wheels"] == ""
    assert "has no images for --map" in problems["drive", "surfels"]
    assert "nowhere" in problems["nowhere", "wheels"]
    assert len(plan.jobs) == 1


def test_a_bug_in_a_reader_is_a_row_too(drive: Path, by_wheels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("no such thing")

    monkeypatch.setattr(jobs, "open_recording", fail)
    (case,) = plan_of([drive], [by_wheels], 1).cases
    assert case.problem is not None
    assert case.problem.startswith("a bug: ZeroDivisionError: no such thing (test_jobs.py:")


def test_settings_that_are_wrong_for_all_are_refused_before_anything_runs(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text("odometri: wheels\n")
    with pytest.raises(ConfigError, match=r"wrong\.yaml:1"):
        plan_of([drive], [tmp_path / "wrong.yaml"], 1)
    (tmp_path / "extends.yaml").write_text("known_map: {path: here, extend: true}\nodometry: dense\n")
    with pytest.raises(ConfigError, match="a batch changes no map"):
        plan_of([drive], [tmp_path / "extends.yaml"], 1)


def test_names_are_as_long_as_they_must_be() -> None:
    paths = [Path("/data/monday/drive"), Path("/data/tuesday/drive"), Path("/data/hall")]
    assert short_names(paths) == ["monday/drive", "tuesday/drive", "hall"]
    assert short_names([Path("/a")]) == ["a"]


def test_long_ones_come_first(tmp_path: Path, by_wheels: Path) -> None:
    drives = [write_wheels(tmp_path / str(readings), readings) for readings in (20, 90, 50)]
    plan = plan_of(drives, [by_wheels], 1)
    assert [Path(one.recording).name for one in plan.jobs.values()] == ["90", "50", "20"]


def test_recordings_are_named_by_paths_patterns_and_folders_each_once(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = write_wheels(tmp_path / "data" / "other", 10)
    assert named_recordings([str(other), str(tmp_path / "data")]) == (other, drive)
    assert named_recordings([str(tmp_path / "data" / "d*")]) == (drive,)
    assert named_recordings([str(tmp_path / "**" / "other")]) == (other,)
    monkeypatch.chdir(tmp_path)
    assert named_recordings(["data/*", str(drive)]) == (Path("data/drive"), Path("data/other"))
    assert named_recordings(["nowhere"]) == (Path("nowhere"),)
    with pytest.raises(ConfigError, match="nothing fits"):
        named_recordings(["nothing*"])
