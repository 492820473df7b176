"""Profiles: settings under one name, over which lies all that a user names."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import pytest

from wheelsight.config import Config, load_config, save_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.settings.base import PI, PROFILES, differing, over_profile


def value_of(config: Config, name: str) -> Any:
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value


@pytest.mark.parametrize("name", PI)
def test_each_setting_of_the_small_computer_is_one_that_a_run_has_and_differs_from_its_default(name: str) -> None:
    small = load_config(overrides={"profile": "pi"})
    assert value_of(small, name) == PI[name].value != value_of(Config(), name)


def test_nothing_else_differs() -> None:
    differs = differing(Config(profile="pi").to_dict(), Config().to_dict())
    assert differs.pop("profile") == "pi"
    assert differs == over_profile("pi", {})


def test_every_profile_can_be_asked_for() -> None:
    allowed = [name for part in get_args(Config.model_fields["profile"].annotation) for name in get_args(part)]
    assert allowed == list(PROFILES)
    with pytest.raises(ConfigError, match=r"--profile is 'px' \(known: 'pi'\)"):
        load_config(overrides={"profile": "px"}, called={"profile": "--profile"})


def test_a_file_lies_over_it_and_options_over_both(tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text("profile: pi\ndense: {keyframe_overlap: 0.7, kept_keyframes: 20}\nfeatures: {keypoints: 300}\n")
    config = load_config(file, {"features.keypoints": 400})
    assert (config.dense.keyframe_overlap, config.dense.kept_keyframes, config.features.keypoints) == (0.7, 20, 400)
    assert config.dense.finest_width_px == PI["dense.finest_width_px"].value
    assert config.features.candidates == PI["features.candidates"].value


def test_what_a_run_wrote_down_gives_the_same_run_again(tmp_path: Path) -> None:
    config = load_config(overrides={"profile": "pi", "navigation.mppi.rollouts": 100})
    save_config(config, tmp_path / "config.yaml")
    assert load_config(tmp_path / "config.yaml") == config


def test_a_section_that_is_no_mapping_is_refused_as_without_a_profile(tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    reported = []
    for head in ("seed: 1\n", ""):
        file.write_text(f"{'profile: pi' if head else ''}\ndense: 3\n")
        with pytest.raises(ConfigError, match="dense is 3") as refused:
            load_config(file)
        reported.append(str(refused.value))
    assert reported[0] == reported[1]
