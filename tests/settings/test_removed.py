"""Names in files that only earlier versions have: refused to a user, dropped where old results are opened."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from changed_settings import all_leaves
from pydantic import ValidationError
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.config import Config, load_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.settings import base
from wheelsight.core.settings.base import REMOVED_FILE, split_removed

REMOVED = """\
report.title_px = 12
report.margin.left_px = 3
report.margin.right_px = null
report.images -> report.pictures
colors.dark = [0, 0.5, true]
"""
OLD = """\
odometry: features
report:
  pictures: 2
  title_px: 14
  margin:
    left_px: 3
    right_px: 7
colors: {dark: [0, 0.5, true]}
"""


@pytest.fixture(autouse=True)
def removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "removed.txt"
    file.write_text(REMOVED)
    monkeypatch.setattr(base, "REMOVED_FILE", file)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    path = tmp_path / "old.yaml"
    path.write_text(OLD)
    return path


def refusal(path: Path | None, overrides: dict[str, object] | None = None) -> str:
    with pytest.raises(ConfigError) as refused:
        load_config(path, overrides, {name: f"--set {name}" for name in overrides or ()})
    return str(refused.value)


def test_a_removed_setting_is_refused_with_the_constant_in_its_place(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    for text, problem in (
        ("title_px: 14", "report.title_px is no longer a setting: it is fixed at 12 (remove the line)"),
        ("margin: {right_px: 1}", "report.margin.right_px is no longer a setting (remove the line)"),
        ("images: 3", "report.images is now report.pictures (rename it)"),
    ):
        path.write_text(f"report:\n  {text}\n")
        assert refusal(path) == f"{path}:2: {problem}"


def test_the_file_of_an_old_run_is_refused_with_the_command_that_keeps_the_rest(old: Path) -> None:
    assert refusal(old) == (
        f"{old}:4: report.title_px is no longer a setting: it is fixed at 12, and 3 more names are gone too "
        f"(remove the line, or keep the rest: wheelsight config --config {old} --drop-removed > NEW.yaml)"
    )


def test_an_option_of_a_removed_setting_does_not_blame_the_file() -> None:
    problem = "--set report.title_px is no longer a setting: it is fixed at 12 (leave it out)"
    assert refusal(None, {"report.title_px": 3}) == problem
    with pytest.raises(ValidationError, match=r"report.title_px is no longer a setting"):
        Config.model_validate({"report": {"title_px": 3}})


def test_an_old_file_is_opened_without_its_removed_settings(old: Path, tmp_path: Path) -> None:
    config = load_config(old, {"features.seed": 3}, drop_removed=True)
    assert config == load_config(overrides={"odometry": "features", "report.pictures": 2, "features.seed": 3})
    old.write_text("report: {images: 3}\n")
    assert load_config(old, drop_removed=True).report.pictures == 3


def test_removed_settings_of_a_section_say_whether_their_value_is_the_constant() -> None:
    kept, found = split_removed({"pictures": 1, "title_px": 12, "margin": {"left_px": 4}, "images": 2}, "report")
    assert kept == {"pictures": 1}
    assert [(one.name, one.differs) for one in found] == [
        ("report.title_px", False),
        ("report.margin.left_px", True),
        ("report.images", False),
    ]


def test_the_command_prints_the_rest_and_warns_of_what_is_lost(old: Path) -> None:
    printed = CliRunner().invoke(app, ["config", "--config", str(old), "--drop-removed", "--changed"])
    assert printed.exit_code == 0, printed.output
    assert yaml.safe_load(printed.stdout)["report"] == {"pictures": 2}
    assert "report.title_px = 14 is lost: it is no longer a setting: it is fixed at 12" in printed.stderr
    assert "report.margin.right_px = 7 is lost: it is no longer a setting" in printed.stderr
    assert "left_px" not in printed.stderr
    assert "colors" not in printed.stderr


def test_the_packaged_list_has_constants_and_new_names_and_no_setting_of_today() -> None:
    today = {name for name, _, _ in all_leaves()} | {"places.weights.with_area", "places.weights.without_area"}
    for line in REMOVED_FILE.read_text(encoding="utf-8").splitlines():
        name, sign, rest = line.split(" ", 2)
        assert name not in today
        assert rest in today if sign == "->" else sign == "="
        if sign == "=":
            json.loads(rest)
