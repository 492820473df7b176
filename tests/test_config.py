from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from wheelsight.config import Config, load_config, save_config
from wheelsight.errors import ConfigError


def write(folder: Path, text: str) -> Path:
    path = folder / "settings.yaml"
    path.write_text(text)
    return path


def refusal(path: Path | None = None, overrides: dict[str, Any] | None = None) -> str:
    with pytest.raises(ConfigError) as refused:
        load_config(path, overrides)
    message = str(refused.value)
    assert "\n" not in message
    return message


def test_without_a_file_all_is_default() -> None:
    assert load_config() == Config()


def test_an_empty_file_is_all_default(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "# nothing\n")) == Config()


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    config = load_config(overrides={"features.seed": 7, "recording.camera": "freiburg2", "report.pictures": 0})
    assert config != Config()
    save_config(config, tmp_path / "out.yaml")
    assert load_config(tmp_path / "out.yaml") == config


def test_a_file_changes_what_it_names_and_options_win_over_it(tmp_path: Path) -> None:
    path = write(tmp_path, "features: {seed: 5}\nevaluation:\n  max_gap_s: 5e-2\n")
    config = load_config(path, {"features.seed": 6})
    assert config.evaluation.max_gap_s == 0.05
    assert config.features.seed == 6
    assert config.recording == Config().recording


def test_an_unknown_setting_is_refused_with_its_line_and_its_neighbour(tmp_path: Path) -> None:
    path = write(tmp_path, "odometry: features\nfeatures:\n  sead: 5\n")
    assert refusal(path) == f"{path}:3: unknown setting features.sead (did you mean seed?)"


def test_an_unknown_section_is_refused_listing_the_known(tmp_path: Path) -> None:
    path = write(tmp_path, "loop_closing: {}\n")
    assert refusal(path).startswith(f"{path}:1: unknown setting loop_closing (known: evaluation, features,")


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("odometry: sonar\n", 1, "odometry is 'sonar' (known: 'features' or 'wheels')"),
        ("report:\n  pictures: many\n", 2, "report.pictures is 'many', which should be a valid integer"),
        ("report:\n  pictures: -1\n", 2, "report.pictures is -1, which should be greater than or equal to 0"),
        ("recording: {max_gap_s: -1}\n", 1, "recording.max_gap_s is -1, which should be greater than or equal to 0"),
        ("recording: {depth_factor: .nan}\n", 1, "recording.depth_factor is nan, which should be"),
        ("features: 3\n", 1, "features is 3, which should be"),
    ],
)
def test_an_impossible_value_is_refused_in_one_line(tmp_path: Path, text: str, line: int, expected: str) -> None:
    path = write(tmp_path, text)
    assert refusal(path).startswith(f"{path}:{line}: {expected}")


def test_an_impossible_option_does_not_blame_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "report: {pictures: 2}\n")
    assert refusal(path, {"odometry": "sonar"}) == "odometry is 'sonar' (known: 'features' or 'wheels')"


def test_an_impossible_option_is_called_what_the_user_knows_it_as() -> None:
    with pytest.raises(ConfigError, match=r"^--seed is 'x', which should be a valid integer"):
        load_config(overrides={"features.seed": "x"}, called={"features.seed": "--seed"})


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"report: [1\n", ":2: is not YAML"),
        (b"- a\n- b\n", ": must hold names and values"),
        (b"\xff\xfe\x00", ": is not a text file"),
    ],
)
def test_what_is_no_settings_file_is_refused(tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "settings.yaml"
    path.write_bytes(content)
    assert refusal(path).startswith(f"{path}{expected}")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "no.yaml") == f"{tmp_path / 'no.yaml'}: cannot be read: No such file or directory"


@pytest.mark.parametrize("names", ["wheels,features", "wheels, features", ["wheels", "features"]])
def test_several_odometries_are_a_list_or_words_with_commas(tmp_path: Path, names: str | list[str]) -> None:
    config = load_config(write(tmp_path, f"odometry: {names}\n"))
    assert config == load_config(overrides={"odometry": names})
    assert config.odometry == ("wheels", "features")
    assert config.to_dict()["odometry"] == ["wheels", "features"]
    save_config(config, tmp_path / "out.yaml")
    assert load_config(tmp_path / "out.yaml") == config


def test_one_odometry_stays_one_word() -> None:
    config = load_config(overrides={"odometry": ["wheels"]})
    assert config.to_dict()["odometry"] == "wheels"
    assert load_config(overrides={"odometry": "wheels,features"}).alone("wheels") == config


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("odometry: wheels,wheels\n", 1, "odometry is 'wheels,wheels', which names wheels twice (known: features, "),
        ("report: {}\nodometry: [wheels, sonar]\n", 2, "odometry is 'sonar' (known: 'features' or "),
        ("odometry: []\n", 1, "odometry is [], which names none (known: features, "),
        ("odometry: wheels,\n", 1, "odometry is '' (known: 'features' or "),
    ],
)
def test_unknown_and_doubled_odometries_are_refused_with_the_list(
    tmp_path: Path, text: str, line: int, expected: str
) -> None:
    path = write(tmp_path, text)
    assert refusal(path).startswith(f"{path}:{line}: {expected}")
