from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from configuration_page import PAGE, page

from wheelsight.config import Config, load_config, save_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.files import settings_text


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


def test_what_is_written_is_the_same_with_libyaml_and_without(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Config().to_dict() | {"note": "of a flat: 3 × 4 m", "start": [0.5, 1e-7, None, True]}
    reported = settings_text(settings)
    monkeypatch.delattr(yaml, "CSafeDumper", raising=False)
    assert reported == settings_text(settings)
    assert yaml.safe_load(reported) == yaml.safe_load(yaml.safe_dump(settings))


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
    assert refusal(path).startswith(
        f"{path}:1: unknown setting loop_closing (known: camera, camera_calibration, clocks,"
    )


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("odometry: sonar\n", 1, "odometry is 'sonar' (known: 'features', 'dense', 'wheels' or 'own')"),
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
    assert refusal(path, {"odometry": "sonar"}) == "odometry is 'sonar' (known: 'features', 'dense', 'wheels' or 'own')"


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
        ("report: {}\nodometry: [wheels, sonar]\n", 2, "odometry is 'sonar' (known: 'features', 'den"),
        ("odometry: []\n", 1, "odometry is [], which names none (known: features, "),
        ("odometry: wheels,\n", 1, "odometry is '' (known: 'features', 'den"),
    ],
)
def test_unknown_and_doubled_odometries_are_refused_with_the_list(
    tmp_path: Path, text: str, line: int, expected: str
) -> None:
    path = write(tmp_path, text)
    assert refusal(path).startswith(f"{path}:{line}: {expected}")


WITH_PLACES = {"odometry": "wheels", "places.model": "three.places"}


def test_places_join_the_wheels_as_a_track_of_their_own() -> None:
    config = load_config(overrides={**WITH_PLACES, "odometry": "wheels,features"})
    assert config.tracks == ("wheels", "features", "rectified", "joined")
    assert config.alone("wheels") == load_config(overrides={"odometry": "wheels"})
    assert config.alone("features") == Config(odometry=("features",))
    assert config.alone("rectified") == load_config(overrides=WITH_PLACES)
    assert Config(odometry=("features",)).tracks == ("features",)


def test_wheels_and_a_camera_are_joined_unless_one_says_otherwise() -> None:
    joined = load_config(overrides={"odometry": "wheels,dense", "map": "surfels"})
    assert (joined.fusion.filter, joined.tracks) == ("default", ("wheels", "dense", "joined"))
    assert joined.alone("joined") == joined
    assert joined.alone("dense") == load_config(overrides={"odometry": "dense"})
    apart = load_config(overrides={"odometry": "wheels,dense", "map": "surfels", "fusion": "none"})
    assert apart.tracks == ("wheels", "dense")
    assert apart.alone("dense").map == "surfels"
    assert load_config(overrides={"odometry": "wheels,features,dense"}).fusion.filter == "none"
    assert Config.model_validate(joined.to_dict()) == joined


@pytest.mark.parametrize("names", ["dense", "wheels", "features,dense", "wheels,features,dense"])
def test_fusion_of_anything_but_wheels_and_one_camera_is_refused(names: str) -> None:
    with pytest.raises(ConfigError, match=r"fusion\.filter joins wheels with one camera odometry, not "):
        load_config(overrides={"odometry": names, "fusion.filter": "default"})


FUSION = """\
odometry: [wheels, dense]
fusion:
  error_state: {clock_sigma_s: 0.002}
  areas: {yaw_sigma_rad: 0.7}
  ligocki: {weight: 0.8}
"""


def test_all_that_filters_go_by_is_read_and_written(tmp_path: Path) -> None:
    path = write(tmp_path, FUSION)
    config = load_config(path, {"fusion.filter": "ligocki"})  # as --fusion ligocki, which leaves the rest as it is
    assert (load_config(path).fusion.filter, config.fusion.filter) == ("default", "ligocki")
    fusion = config.fusion
    found = (fusion.error_state.clock_sigma_s, fusion.areas.yaw_sigma_rad, fusion.ligocki.weight)
    assert found == (0.002, 0.7, 0.8)
    save_config(config, tmp_path / "resolved.yaml")
    assert load_config(tmp_path / "resolved.yaml") == config
    written = yaml.safe_load((tmp_path / "resolved.yaml").read_text())["fusion"]
    assert written["error_state"]["confidence"] == 0.999
    assert config.alone("wheels").fusion.error_state == fusion.error_state


def test_a_name_alone_says_which_filter_joins(tmp_path: Path) -> None:
    assert load_config(write(tmp_path, "odometry: [wheels, dense]\nfusion: ligocki\n")).fusion.filter == "ligocki"
    apart = load_config(write(tmp_path, "odometry: [wheels, dense]\nfusion: ligocki\n"), {"fusion.filter": "none"})
    assert apart.fusion.filter == "none"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("fusion: kalman", "fusion.filter is 'kalman' "),
        ("fusion: {error_state: {scale_sigma: -1}}", "fusion.error_state.scale_sigma is -1"),
        ("fusion: {error_state: {window_s: .inf}}", "fusion.error_state.window_s is inf"),
        ("fusion: {ligocki: {weight: 1.0}}", "fusion.ligocki.weight is 1.0"),
        ("fusion: {ligocki: {wait: 0.5}}", "unknown setting fusion.ligocki.wait (did you mean weight?)"),
    ],
)
def test_a_setting_of_a_filter_that_is_none_is_named_with_its_line(tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"settings.yaml:2: {said}")):
        load_config(write(tmp_path, f"odometry: [wheels, dense]\n{line}\n"))


def test_what_is_written_of_places_is_what_was_used(tmp_path: Path) -> None:
    start = {"places.start": "1.5,-2,90"}
    for extra, expected in (
        ({}, ("probabilistic", None, None)),
        ({"places.rectify": "paper"}, ("paper", "increment", {"with_area": [0, 0.9, 0.1], "without_area": [0, 1]})),
    ):
        config = load_config(overrides={**WITH_PLACES, **start, **extra})
        save_config(config, tmp_path / "out.yaml")
        assert load_config(tmp_path / "out.yaml") == config
        written = config.to_dict()["places"]
        assert (written["rectify"], written["odometry_term"], written["weights"]) == expected
        assert written["start"] == {"x_m": 1.5, "y_m": -2, "yaw_deg": 90}


def test_weights_share_out_what_gamma_leaves_where_areas_tell_nothing() -> None:
    config = load_config(overrides={**WITH_PLACES, "places.rectify": "paper", "places.weights": "0.2,0.6,0.2"})
    assert config.places.weights is not None
    assert config.places.weights.without_area == pytest.approx((0.25, 0.75))
    only_areas = load_config(overrides={**WITH_PLACES, "places.rectify": "paper", "places.weights": "0,0,1"})
    assert only_areas.places.weights is not None
    assert only_areas.places.weights.without_area == (0, 1)


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        (
            "odometry: features\nplaces: {model: m}\n",
            2,
            "places.model rectifies wheels, and there are none (add --odom",
        ),
        ("places:\n  rectify: paper\n", 2, "places.rectify is given without a model of places (add --places MODEL)"),
        ("places: {start: '1,2,3'}\n", 1, "places.start is given without a model of places"),
        ("odometry: wheels\nplaces: {model: m, weights: '0,1,0'}\n", 2, "places.weights is of the paper's eq. 5 alone"),
        (
            "odometry: wheels\nplaces: {model: m, start: '1,2'}\n",
            2,
            "places.start is '1,2', which should be 3 numbers: X",
        ),
        ("odometry: wheels\nplaces: {model: m, start: {x_m: 1, y_m: 2}}\n", 2, "places.start.yaw_deg is missing"),
        ("odometry: wheels\nplaces: {model: m, start: {x: 1}}\n", 2, "places.start.x_m is missing"),
        ("odometry: wheels\nplaces:\n  model: m\n  rectify: magic\n", 4, "places.rectify is 'magic' (known: 'probab"),
        (
            "odometry: wheels\nplaces: {model: m, rectify: paper, weights: '0,1,1'}\n",
            2,
            "places.weights is '0,1,1', which",
        ),
    ],
)
def test_settings_of_places_that_cannot_be_are_refused_in_one_line(
    tmp_path: Path, text: str, line: int, expected: str
) -> None:
    path = write(tmp_path, text)
    assert refusal(path).startswith(f"{path}:{line}: {expected}")


def test_a_wrong_option_of_places_is_called_by_its_name() -> None:
    called = {"places.start": "--start", "places.rectify": "--rectify"}
    with pytest.raises(ConfigError, match=r"^--start yaw_deg is nan, which should be a finite number"):
        load_config(overrides={**WITH_PLACES, "places.start": "1,2,nan"}, called=called)
    with pytest.raises(ConfigError, match=r"^--rectify is given without a model of places .add --places MODEL.$"):
        load_config(overrides={"odometry": "wheels", "places.rectify": "paper"}, called=called)


def test_an_unknown_setting_within_one_that_may_be_missing_lists_the_known(tmp_path: Path) -> None:
    given = "odometry: wheels\nplaces: {model: m, start: {x_m: 1, y_m: 2, yaw_deg: 3, yaw_rad: 3}}\n"
    assert "unknown setting places.start.yaw_rad (did you mean yaw_deg?)" in refusal(write(tmp_path, given))


def test_the_page_of_all_settings_is_of_today() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run: python tests/configuration_page.py"
