"""The paper's script: its drives, its methods, its table, its figure, its errors."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest

from wheelsight.core.errors import InputError
from wheelsight.core.geometry import se3

pytest.importorskip("matplotlib", reason="the papers' scripts need the extra 'papers'")
pytest.importorskip("mujoco", reason="this script simulates")

PARTS = ("trinh_rectification", "_trinh_drives", "_trinh_trial", "_trinh_figure")
STEP_S, SPEED_M_S, TURN_RAD_S = 0.1, 0.8, 0.8


@pytest.fixture(scope="module")
def parts(project_folder: Path) -> Iterator[dict[str, ModuleType]]:
    sys.path.insert(0, str(project_folder / "papers"))
    try:
        yield {name: importlib.import_module(name) for name in PARTS}
    finally:
        sys.path.remove(str(project_folder / "papers"))
        for name in PARTS:
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def world() -> Any:
    from wheelsight_sim import build_world

    return build_world("floor4", 0)


def made_drive(parts: dict[str, ModuleType], world: Any, seed: int, laps: int = 2, frames: int = 180) -> Any:
    """A drive straight from waypoint to waypoint, whose frames tell their area with noise and some confusion."""
    rng = np.random.default_rng(seed)
    robot = parts["trinh_rectification"].ROBOT
    poses, wheels_m = driven(np.concatenate([np.tile(world.route, (laps, 1)), world.route[:1]]), robot.track_width_m)
    radii_m = np.array([robot.left_radius_m, robot.right_radius_m])
    ticks = np.floor(wheels_m / (2 * np.pi * radii_m) * robot.nominal.ticks_per_turn)
    stamps_s = STEP_S * np.arange(len(poses))
    chosen = np.linspace(0, len(poses) - 1, frames).round().astype(int)
    labels = world.areas.index_at(poses[chosen, :2])
    seen = np.where(rng.random(frames) < 0.1, rng.integers(0, len(world.areas), frames), labels)
    histograms, layout = (
        (seen_by[:, None] == np.arange(size) % len(world.areas)) + rng.normal(0, noise, (frames, size))
        for seen_by, size, noise in (
            (seen, parts["_trinh_drives"].HISTOGRAMS.size, 0.4),
            (labels, parts["_trinh_drives"].LAYOUT.size, 0.3),
        )
    )
    T_odom_base = se3.from_plane(*poses.T)
    return parts["_trinh_drives"].DescribedDrive(
        stamps_s=stamps_s[chosen],
        T_map_base=T_odom_base[chosen],
        labels=labels,
        histograms=histograms.astype(np.float32),
        layout=layout.astype(np.float32),
        has_depth=np.ones(frames, bool),
        frame_size=np.array([240, 320, 240, 320]),
        ticks=np.column_stack([stamps_s, ticks]),
        T_map_start=T_odom_base[0],
    )


def driven(waypoints: Any, track_m: float) -> tuple[Any, Any]:
    """Poses (N, 3) every tenth of a second, and the way of both wheels (N, 2), turning on the spot at waypoints."""
    poses, wheels_m = [np.array([*waypoints[0], 0.0])], [np.zeros(2)]

    def go(way_m: float, turn_rad: float) -> None:
        x, y, yaw = poses[-1]
        poses.append(np.array([x + way_m * np.cos(yaw), y + way_m * np.sin(yaw), yaw + turn_rad]))
        wheels_m.append(wheels_m[-1] + way_m + np.array([-0.5, 0.5]) * track_m * turn_rad)

    for goal in waypoints[1:]:
        away = goal - poses[-1][:2]
        turn_rad = np.arctan2(away[1], away[0]) - poses[-1][2]
        turn_rad = (turn_rad + np.pi) % (2 * np.pi) - np.pi
        for total, pace, is_turn in ((turn_rad, TURN_RAD_S, True), (np.hypot(*away), SPEED_M_S, False)):
            count = int(np.ceil(abs(total) / (pace * STEP_S)))
            for _ in range(count):
                go(0.0 if is_turn else total / count, total / count if is_turn else 0.0)
    return np.array(poses), np.array(wheels_m)


@pytest.fixture(scope="module")
def trial(parts: dict[str, ModuleType], world: Any) -> Any:
    training = [made_drive(parts, world, seed) for seed in range(3)]
    test = [made_drive(parts, world, 10)]
    wheels = parts["trinh_rectification"].ROBOT.nominal
    return parts["_trinh_trial"].run_trial(
        world.areas, wheels, training, test, most_trees=2, full_trees=16, terms=("increment",)
    )


@pytest.mark.slow
def test_both_ways_rectify_and_the_probabilistic_one_by_far_the_most(trial: Any) -> None:
    """The order that the paper's table and the page beside it claim, on drives that no forest has seen."""
    alone = trial.errors["wheels"].mean_m
    paper = trial.errors["eq. 5, increment, 2"]
    probabilistic = trial.errors["probabilistic, layout, 16"]
    assert alone > 15
    assert paper.mean_m < 0.6 * alone
    assert probabilistic.mean_m < 0.08 * alone
    assert probabilistic.accuracy > paper.accuracy
    assert all(errors.rms_m >= errors.mean_m for errors in trial.errors.values())


def test_weights_are_those_of_eq_5(trial: Any) -> None:
    alpha, beta, gamma, beta_unreported = trial.errors["eq. 5, increment, 2"].weights
    assert alpha + beta + gamma == pytest.approx(1)
    assert gamma > 0
    assert 0 <= beta_unreported <= 1


def test_the_papers_rmse_is_a_mean_of_distances(parts: dict[str, ModuleType], world: Any) -> None:
    drive = made_drive(parts, world, 1, laps=1, frames=40)
    off = np.zeros((40, 2))
    off[:20] = 3.0, 4.0
    mean_m, rms_m = parts["_trinh_trial"].distances([drive.truth + off], [drive])
    assert mean_m == pytest.approx(2.5)
    assert rms_m == pytest.approx(np.sqrt(12.5))


def test_true_sizes_reckon_a_made_drive_right(parts: dict[str, ModuleType], world: Any) -> None:
    drive = made_drive(parts, world, 1, laps=1, frames=40)
    off = drive.odometry(parts["trinh_rectification"].ROBOT.wheels) - drive.truth
    assert np.hypot(*off.T).max() < 0.2


def test_answers_for_weights_come_from_forests_that_have_not_seen_the_drive(
    parts: dict[str, ModuleType], world: Any
) -> None:
    """With labels that features do not tell, a forest that knew the frames would still be right."""
    from wheelsight.places import ForestSettings

    rng = np.random.default_rng(0)
    drives = [made_drive(parts, world, seed, laps=1, frames=90) for seed in range(3)]
    blind = [
        replace(drive, histograms=rng.random(drive.histograms.shape, np.float32), labels=rng.permutation(drive.labels))
        for drive in drives
    ]
    reported = parts["_trinh_trial"].held_out_answers(world.areas, blind, ForestSettings(trees=6))
    right = np.mean([np.mean(areas == drive.labels) for areas, drive in zip(reported, blind, strict=True)])
    assert right < 0.45


def test_drives_are_kept_and_not_made_again(
    parts: dict[str, ModuleType], world: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from wheelsight_sim import SimulationSettings

    drives = parts["_trinh_drives"]
    wanted = [drives.DriveSettings(SimulationSettings(seed=seed), 40) for seed in (1, 2)]
    assert wanted[0].file(tmp_path) != replace(wanted[0], frames=41).file(tmp_path)
    for settings in wanted:
        made_drive(parts, world, settings.simulation.seed, laps=1, frames=40).save(settings.file(tmp_path))
    monkeypatch.setattr(drives, "simulate", lambda *_: pytest.fail("simulated again"))
    first, second = drives.make_drives(wanted, tmp_path, is_quiet=True)
    assert np.array_equal(first.labels, made_drive(parts, world, 1, laps=1, frames=40).labels)
    assert not np.array_equal(first.histograms, second.histograms)


def test_a_damaged_drive_is_named(parts: dict[str, ModuleType], tmp_path: Path) -> None:
    (tmp_path / "drive.npz").write_bytes(b"PK half a file")
    with pytest.raises(InputError, match=r"drive\.npz: is no drive \(delete it; it will be made again\)"):
        parts["_trinh_drives"].DescribedDrive.load(tmp_path / "drive.npz")


def test_the_plan_has_the_papers_number_of_frames_and_no_seed_twice(parts: dict[str, ModuleType]) -> None:
    plan = parts["trinh_rectification"].Plan()
    assert sum(drive.frames for drive in plan.training_drives(1)) == 1433
    drives = [drive for seed in (1, 2, 3) for drive in plan.training_drives(seed) + plan.test_drives(seed)]
    seeds = [drive.simulation.seed for drive in drives]
    assert len(set(seeds)) == len(seeds)
    assert not any(drive.simulation.is_reverse for drive in drives)
    turned = parts["trinh_rectification"].Plan(both_ways=True).training_drives(1)
    assert [drive.simulation.is_reverse for drive in turned] == 4 * [False, True]


def test_the_table_stands_beside_the_papers(parts: dict[str, ModuleType]) -> None:
    script, Trial, Errors = (
        parts["trinh_rectification"],
        parts["_trinh_trial"].Trial,
        parts["_trinh_trial"].Errors,
    )
    trials = [
        Trial({"wheels": Errors(wheels_m, 30.0), "eq. 5, absolute, 6": Errors(8.0, 9.0, 0.8, 0.04)}, wheels_m)
        for wheels_m in (20.0, 32.0)
    ]
    printed = script.table(trials, script.Plan(seeds=2))
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.splitlines() if "|" in line]
    assert rows[2][:3] == ["wheels alone", "", "26.00 ± 8.49 m"]
    assert rows[2][-1] == "26.4 m"
    assert rows[3][:4] == ["eq. 5, absolute", "6", "8.00 ± 0.00 m", "0.325 ± 0.106"]
    assert rows[3][-1] == "8.9 m, 0.34"


@pytest.mark.slow
def test_the_figure_shows_truth_and_methods(
    parts: dict[str, ModuleType], world: Any, trial: Any, tmp_path: Path
) -> None:
    drawn = {"eq. 5": "eq. 5, increment, 2", "probabilistic": "probabilistic, layout, 16"}
    methods = {title: trial.tracks[name] for title, name in drawn.items()}
    truth = made_drive(parts, world, 10).truth
    figure = parts["_trinh_figure"]
    figure.draw(world, truth, trial.tracks["wheels"], methods, tmp_path / "drawn.png")
    image = cv2.imread(str(tmp_path / "drawn.png"))
    assert image is not None
    assert image.shape[1] > 1200
    colours = set(map(tuple, image.reshape(-1, 3)[:, ::-1].tolist()))
    for colour in (figure.INK, figure.WHEELS, *figure.METHODS):
        assert tuple(bytes.fromhex(colour[1:])) in colours
    assert (tmp_path / "drawn.png").stat().st_size < 250_000


def test_errors_are_one_line_and_code_2(
    parts: dict[str, ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    for arguments, says in (
        (["--seeds", "0", "--out", str(tmp_path / "o")], "--seeds is 0 (give 1 or more)"),
        (["--out", str(tmp_path / "file")], "file"),
    ):
        assert parts["trinh_rectification"].main(arguments) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1


@pytest.mark.slow
def test_one_command_makes_drives_table_and_figure(
    parts: dict[str, ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A lap each: simulated, rendered, described, trained on and rectified."""
    script = parts["trinh_rectification"]
    plan = script.Plan(seeds=1, laps=1, training=2, frames=100, test=1, passersby=1, trees=2, full_trees=32)
    assert script.main(["--out", str(tmp_path / "o")], plan) == 0
    printed = capsys.readouterr().out
    assert "probabilistic, layout" in printed
    assert {path.name for path in (tmp_path / "o").iterdir()} == {
        "drives", "rectification.png", "results.json", "table.md",
    }  # fmt: skip
    errors = json.loads((tmp_path / "o" / "results.json").read_text())["sets"][0]["errors"]
    alone, paper = errors["wheels"]["mean_m"], errors["eq. 5, increment, 2"]
    best = errors["probabilistic, layout, 32"]
    assert alone > 10
    assert paper["mean_m"] < 0.7 * alone
    assert best["mean_m"] < 0.08 * alone
    assert best["accuracy"] > 0.9 > paper["accuracy"]
