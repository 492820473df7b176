"""`places` from the command line: from a drive to labels, a model, figures and predictions, and each bad input."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from places.made_recording import write_drive
from typer.testing import Result

from wheelsight.places import PlaceModel
from wheelsight_papers import read_labels

Command = Callable[..., Result]
Refusal = Callable[..., str]
QUICK = ("--description", "histograms", "--trees", 8)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two drives through the same rooms."""
    folder = tmp_path_factory.mktemp("drives")
    return write_drive(folder / "monday", seed=1), write_drive(folder / "tuesday", seed=2)


@pytest.fixture
def drives(written: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Path]:
    """Copies, which may be changed."""
    monday, tuesday = (Path(shutil.copytree(drive, tmp_path / drive.name)) for drive in written)
    return monday, tuesday


@pytest.fixture
def model(wheelsight: Command, drives: tuple[Path, Path], tmp_path: Path) -> Path:
    """A model of the first drive."""
    result = wheelsight("places", "train", drives[0], *QUICK, "--out", tmp_path / "rooms.places")
    assert result.exit_code == 0, result.output
    return tmp_path / "rooms.places"


def test_training_shows_what_the_model_is_worth_and_keeps_settings(
    wheelsight: Command, drives: tuple[Path, Path], tmp_path: Path
) -> None:
    out = tmp_path / "models" / "rooms.places"
    result = wheelsight("places", "train", *drives, *QUICK, "--depth", 5, "--seed", 3, "--out", out)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    trained = PlaceModel.load(out)
    assert trained.area_names == ("corridor", "hall", "lift")
    assert (trained.forest.tree_count, trained.settings.max_depth, trained.settings.seed) == (8, 5, 3)
    assert trained.describer.kind == "histograms"
    assert "8 trees of at most 5 splits, histograms; whole drives held out in turn" in result.stdout
    rows = {line.split()[0]: line.split()[1] for line in result.stdout.splitlines() if len(line.split()) >= 3}
    assert [rows[name] for name in trained.area_names] == ["40", "40", "40"]
    assert f"calibration error    {trained.figures.calibration_error:.3f}; " in result.stdout
    assert "out-of-bag accuracy" in result.stdout
    assert f"model: {out}" in result.stdout


@pytest.mark.slow
def test_the_same_seed_trains_the_same_model(wheelsight: Command, drives: tuple[Path, Path], tmp_path: Path) -> None:
    for name in ("a", "b"):
        wheelsight("places", "train", drives[0], *QUICK, "--out", tmp_path / name)
    a, b = (PlaceModel.load(tmp_path / name) for name in ("a", "b"))
    np.testing.assert_array_equal(a.forest.threshold, b.forest.threshold)
    assert a.figures == b.figures


def test_a_trial_is_printed_and_drawn(
    wheelsight: Command, drives: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    page = tmp_path / "trial.html"
    result = wheelsight("places", "test", model, drives[1], "--out", page)
    assert result.exit_code == 0, result.output
    assert "tuesday: 60 frames with a true area" in result.stdout
    assert f"page: {page}" in result.stdout
    assert "plot-confusion" in page.read_text()
    reported = json.loads(wheelsight("places", "test", model, drives[1], "--json").stdout)
    assert reported["areas"] == ["corridor", "hall", "lift"]
    assert (reported["frames"], reported["judged_frames"]) == (60, 60)
    assert np.sum(reported["confusion"]) == 60
    assert np.trace(reported["confusion"]) / 60 == reported["accuracy"] > 0.9


def test_predictions_are_labels_for_a_page(
    wheelsight: Command, drives: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    table, page = tmp_path / "predictions.csv", tmp_path / "check.html"
    result = wheelsight("places", "predict", model, drives[1], "--out", table)
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith(f"60 frames are in {table}, ")
    assert len(read_labels(table).entries) == 60
    result = wheelsight("places", "label", drives[1], "--labels", table, "--every", 0.5, "--out", page)
    assert result.exit_code == 0, result.output
    assert result.stderr.startswith("12 thumbnails, ")
    assert "proposed areas: predictions.csv" in page.read_text()


def test_a_bare_recording_gets_a_page_without_proposals(wheelsight: Command, tmp_path: Path) -> None:
    bare = write_drive(tmp_path / "bare", with_areas=False, with_truth=False)
    result = wheelsight("places", "label", bare, "--out", tmp_path / "page.html")
    assert result.stderr.startswith("6 thumbnails, 0 of them with an area proposed, are in ")
    assert "no areas proposed" in (tmp_path / "page.html").read_text()


def test_areas_and_a_trajectory_of_the_camera_may_come_from_elsewhere(
    wheelsight: Command, drives: tuple[Path, Path], model: Path, tmp_path: Path
) -> None:
    bare = write_drive(tmp_path / "bare", with_areas=False, with_truth=False)
    camera = tmp_path / "camera.txt"
    # 0.3 m ahead of a base that stands at 2.8 m, within the corridor; the camera itself is in the hall
    lines = [f"{0.5 * i} 3.1 0 0.9 -0.5 0.5 -0.5 0.5\n" for i in range(13)]
    camera.write_text("# frames: T_map_camera\n" + "".join(lines))
    places = ("--areas", drives[0] / "areas.yaml", "--trajectory", camera)
    reported = json.loads(wheelsight("places", "test", model, bare, *places, "--json").stdout)
    assert [sum(row) for row in reported["confusion"]] == [60, 0, 0]


@pytest.mark.slow
def test_ranges_train_as_polygons_do(wheelsight: Command, drives: tuple[Path, Path], tmp_path: Path) -> None:
    ranges = tmp_path / "ranges.csv"
    ranges.write_text("from_s,to_s,area\n0,1.95,corridor\n1.95,3.95,hall\n3.95,6,lift\n")
    wheelsight("places", "train", drives[0], *QUICK, "--labels", ranges, "--out", tmp_path / "a")
    wheelsight("places", "train", drives[0], *QUICK, "--out", tmp_path / "b")
    assert PlaceModel.load(tmp_path / "a").figures == PlaceModel.load(tmp_path / "b").figures


@pytest.mark.parametrize("command", ["label", "train", "test", "predict"])
def test_help_shows_examples(wheelsight: Command, command: str) -> None:
    assert f"wheelsight places {command} " in wheelsight("places", command, "--help").stdout


class TestRefusals:
    def test_an_area_never_driven_through(self, refusal: Refusal, tmp_path: Path) -> None:
        short = write_drive(tmp_path / "short", visited=(0, 1))
        text = refusal("places", "train", short, *QUICK, "--out", tmp_path / "m")
        expected = "area 'lift' has no training frames (drive through it, or leave the area out)"
        assert text == f"{short / 'areas.yaml'}: {expected}"

    def test_labels_of_another_recording(self, refusal: Refusal, drives: tuple[Path, Path], tmp_path: Path) -> None:
        (tmp_path / "l.csv").write_text("from_s,to_s,area\n100,120,hall\n")
        text = refusal("places", "train", drives[0], "--labels", tmp_path / "l.csv", "--out", tmp_path / "m")
        assert text.startswith(f"{tmp_path / 'l.csv'}:2: 100.000 to 120.000 s lies outside the recording, 0.000 to 5.9")

    def test_fewer_labels_than_recordings(self, refusal: Refusal, drives: tuple[Path, Path], tmp_path: Path) -> None:
        (tmp_path / "l.csv").write_text("from_s,to_s,area\n0,1,hall\n")
        text = refusal("places", "train", *drives, "--labels", tmp_path / "l.csv", "--out", tmp_path / "m")
        assert text.startswith("1 --labels for 2 recordings (give --labels once for each recording")

    def test_nothing_shows_the_areas(self, refusal: Refusal, tmp_path: Path) -> None:
        bare = write_drive(tmp_path / "bare", with_areas=False)
        fix = "give --labels FILE; wheelsight places label makes a page to write one"
        text = refusal("places", "train", bare, "--out", tmp_path / "m")
        assert text == f"{bare}: has no labels ({fix})"
        lost = write_drive(tmp_path / "lost", with_truth=False)
        text = refusal("places", "train", lost, "--out", tmp_path / "m")
        assert text == f"{lost}: has no ground truth to go with areas ({fix})"

    def test_areas_that_the_model_does_not_know(
        self, refusal: Refusal, drives: tuple[Path, Path], model: Path, tmp_path: Path
    ) -> None:
        text = (drives[1] / "areas.yaml").read_text().replace("name: lift", "name: stairs")
        (tmp_path / "other.yaml").write_text(text)
        reported = refusal("places", "test", model, drives[1], "--areas", tmp_path / "other.yaml")
        assert reported == f"{tmp_path / 'other.yaml'}: area 'stairs' is not known here (known: corridor, hall, lift)"

    def test_what_is_no_model(self, refusal: Refusal, drives: tuple[Path, Path], tmp_path: Path) -> None:
        (tmp_path / "m").write_text("none")
        assert refusal("places", "test", tmp_path / "m", drives[0]).startswith(
            f"{tmp_path / 'm'}: is no model of places"
        )
        assert "cannot be read" in refusal("places", "predict", tmp_path / "n", drives[0], "--out", tmp_path / "p")

    def test_outputs_are_not_overwritten(self, refusal: Refusal, drives: tuple[Path, Path], model: Path) -> None:
        for arguments in (("train", drives[0]), ("label", drives[0]), ("predict", model, drives[0])):
            text = refusal("places", *arguments, "--out", model)
            assert text == f"{model}: is there already (choose another --out, or add --force to overwrite)"
        assert "is a folder" in refusal("places", "label", drives[0], "--out", drives[0])
