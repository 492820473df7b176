"""`wheelsight config`, and `--profile` of runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from changed_settings import all_leaves
from typer.main import get_command
from typer.testing import Result

from wheelsight.app.cli import app
from wheelsight.app.cli.drive import drive_settings
from wheelsight.app.cli.drive_options import DriveOptions
from wheelsight.app.cli.options import SET_BY
from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.settings.base import over_profile
from wheelsight.estimation import choose_odometry

Command = Callable[..., Result]
Refusal = Callable[..., str]


def test_all_settings_are_printed_as_a_run_takes_them(wheelsight: Command, tmp_path: Path) -> None:
    printed = wheelsight("config")
    assert printed.exit_code == 0, printed.output
    file = tmp_path / "all.yaml"
    file.write_text(printed.stdout)
    assert load_config(file) == Config()


def test_each_option_of_a_setting_shows_its_default() -> None:
    commands: Any = get_command(app)
    options = {name: option for option in commands.commands["run"].params for name in option.opts}
    leaves = {name: value for name, value, _ in all_leaves()}
    for name, flag in SET_BY.items():
        default, shown = leaves[name], options[flag].show_default
        if default in (None, (), False) or name == "fusion.filter":  # which depends on others
            continue
        assert shown == (flag if default is True else str(default)), name


def test_what_a_profile_changes_is_printed_alone_and_options_of_a_file_over_it(
    wheelsight: Command, tmp_path: Path
) -> None:
    changed = yaml.safe_load(wheelsight("config", "--profile", "pi", "--changed").stdout)
    assert changed == {"profile": "pi", **over_profile("pi", {})}
    file = tmp_path / "own.yaml"
    file.write_text("features: {seed: 7}\nnavigation: {mppi: {rollouts: 2000}}\n")
    changed = yaml.safe_load(wheelsight("config", "--profile", "pi", "--config", file, "--changed").stdout)
    assert changed["features"]["seed"] == 7
    assert "navigation" not in changed


def test_a_profile_that_is_not_there_is_refused(refusal: Refusal, tmp_path: Path) -> None:
    reported = "--profile is 'nano' (known: 'pi')"
    assert refusal("config", "--profile", "nano") == reported
    assert refusal("run", tmp_path, "--profile", "nano", "--out", tmp_path / "out") == reported


def test_a_run_writes_down_its_profile(wheelsight: Command, wheels: Path, tmp_path: Path) -> None:
    result = wheelsight("run", wheels, "--odometry", "wheels", "--profile", "pi", "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    written = load_config(tmp_path / "out" / "config.yaml")
    assert written == load_config(overrides={"profile": "pi", "odometry": "wheels"})


def test_a_drive_goes_by_a_profile_and_by_what_is_set_over_it() -> None:
    options = DriveOptions(explore=True, out=Path("out"), profile="pi", set_=["navigation.mppi.rollouts=300"])
    config = drive_settings(options)
    assert (config.profile, config.navigation.mppi.rollouts, config.localizer.most_width_px) == ("pi", 300, 320)


@pytest.mark.parametrize("change", ["", "features.reference=previous", "features.seed=3"])
def test_a_drive_chooses_its_odometry_as_a_run_does(change: str) -> None:
    options = DriveOptions(explore=True, out=Path("out"), set_=[change] if change else [])
    mount, wheels = np.eye(4), Wheels(0.1, 0.1, 0.4, 4000.0)
    camera = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
    robot = Calibration.registered_camera(camera, T_base_camera=mount, wheels=wheels)
    name, _, value = change.partition("=")
    chosen = choose_odometry(robot, load_config(overrides={name: value} if change else {}))
    assert drive_settings(options).odometry == chosen.odometry
    assert chosen.odometry == ("wheels", "features" if "reference" in change else "dense")
    assert drive_settings(options).tracks[-1] == "joined"


def test_a_drive_goes_by_the_odometry_that_is_named() -> None:
    options = DriveOptions(explore=True, out=Path("out"), set_=["odometry=wheels,features"])
    assert drive_settings(options).odometry == ("wheels", "features")
