"""Settings: each has a bound, a reason and a source, is read by somebody, and reaches the objects of a run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import numpy as np
import pytest
from changed_settings import all_leaves, bounds, sections
from sources import PACKAGES, ROOT
from stand_ins import CAMERA, MemoryRecording

import wheelsight
from wheelsight.app.run import RealTimeRecording
from wheelsight.config import Config, load_config, save_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import YawRate
from wheelsight.core.settings import Settings
from wheelsight.estimation import ErrorStateSettings, Localizer
from wheelsight.estimation.pose_belief import FilterParameters
from wheelsight.wheels import YawRateMeter

PACKAGE = Path(wheelsight.__file__).parent
LEAVES = all_leaves()
NUMBERS = [leaf for leaf in LEAVES if isinstance(leaf[1], int | float) and not isinstance(leaf[1], bool)]


def section_of(leaf: tuple[str, Any, Any]) -> str:
    return leaf[0].rpartition(".")[0]


# Numbers by the section that they stand in: a test each of eight hundred would cost more than what it tries.
SECTIONS = {section or "top": [*leaves] for section, leaves in groupby(sorted(NUMBERS, key=section_of), section_of)}
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1]])
CALIBRATION = Calibration.registered_camera(
    CAMERA, wheels=Wheels(0.17, 0.17, 0.52, 3200.0), T_base_camera=T_BASE_CAMERA, source="test"
)


def with_value(dotted: str, value: Any) -> str:
    """YAML of one setting, a line a level."""
    names = dotted.split(".")
    return "".join(f"{'  ' * depth}{name}:\n" for depth, name in enumerate(names))[:-1] + f" {value}\n"


def classes(of: type[Settings] = Settings) -> Iterator[type[Settings]]:
    """All classes of settings, those that no configuration holds too."""
    for kind in of.__subclasses__():
        if kind.__module__.startswith("wheelsight."):
            yield kind
            yield from classes(kind)


KINDS = list(classes())


@pytest.mark.parametrize("kind", KINDS, ids=[f"{kind.__module__}.{kind.__name__}" for kind in KINDS])
def test_each_field_has_its_reason_and_its_source(kind: type[Settings]) -> None:
    own = [(name, about) for name, about in kind.model_fields.items() if not isinstance(about.default, Settings)]
    assert [name for name, about in own if not about.description] == []
    sources = {name: (about.json_schema_extra or {}).get("source") for name, about in own}  # type: ignore[union-attr]
    assert [name for name, source in sources.items() if not source] == []


def test_fields_have_one_form() -> None:
    """By `setting`, so that none comes without reason and source. What a page may say is no setting."""
    modules = {path.relative_to(PACKAGE).as_posix(): path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    imports = [
        (module, alias.name)
        for module, text in modules.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and node.module == "pydantic"
        for alias in node.names
    ]
    assert {module for module, name in imports if name == "Field"} == {"core/settings/base.py", "app/page/session.py"}


def numbers_in(kind: Any) -> Iterator[Any]:
    """Of the types that a field is made of, those that are numbers, with what they are annotated with."""
    if get_origin(kind) is Annotated:
        yield from ((kind,) if get_args(kind)[0] in (int, float) else numbers_in(get_args(kind)[0]))
    elif kind in (int, float):
        yield kind
    for part in get_args(kind) if get_origin(kind) is tuple else ():
        yield from numbers_in(part)


@pytest.mark.parametrize("kind", KINDS, ids=[f"{kind.__module__}.{kind.__name__}" for kind in KINDS])
def test_each_of_several_numbers_has_bounds(kind: type[Settings]) -> None:
    """And there are not endlessly many of them."""
    for name, about in kind.model_fields.items():
        several = [*numbers_in(about.annotation)] if get_origin(about.annotation) is tuple else []
        for number in several:
            (limits,) = get_args(number)[1:] or ({},)
            assert {"gt", "ge"} & bounds(limits).keys(), name
            assert {"lt", "le"} & bounds(limits).keys(), name
        if Ellipsis in get_args(about.annotation) and several:
            assert any(hasattr(rule, "max_length") for rule in about.metadata), name


def test_each_setting_says_what_it_is_and_where_its_default_comes_from() -> None:
    assert len(LEAVES) > 100
    silent = [name for name, _, about in LEAVES if not about.description]
    assert silent == []
    sources = {name: about.json_schema_extra for name, _, about in LEAVES}
    assert [name for name, extra in sources.items() if not (isinstance(extra, dict) and extra["source"])] == []


@pytest.mark.parametrize("section", SECTIONS)
def test_nonsense_is_refused_with_file_line_and_what_would_be_right(section: str, tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    for name, value, about in SECTIONS[section]:
        limits = bounds(about)
        lowest, highest = limits.get("gt", limits.get("ge")), limits.get("lt", limits.get("le"))
        assert lowest is not None, name
        assert highest is not None, name
        assert lowest <= value <= highest, name
        for wrong in (lowest - 1, highest + 1, ".nan", "much"):
            path.write_text(with_value(name, wrong))
            reported = str(wrong).replace(".nan", "nan")
            line = name.count(".") + 1
            with pytest.raises(ConfigError, match=rf"^{path}:{line}: {name} is '?{reported}'?, which should be"):
                load_config(path)


def test_all_of_them_are_in_the_config_of_a_run(tmp_path: Path) -> None:
    config = load_config(overrides={"clocks.followers": 5, "features.seed": 7})
    save_config(config, tmp_path / "config.yaml")
    text = (tmp_path / "config.yaml").read_text()
    assert load_config(tmp_path / "config.yaml") == config
    assert [name for name, _, _ in LEAVES if f" {name.rsplit('.')[-1]}:" not in f" {text}".replace("\n", " ")] == []


def test_no_setting_is_dead() -> None:
    """Each is read somewhere."""
    read: set[str] = set()
    for path in (path for name in PACKAGES for path in (ROOT / name).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        read |= {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Load)}
    left = [name for name, _, _ in LEAVES if name.rsplit(".")[-1] not in read]
    assert [name for name in left if not is_of_an_error(name) and not name.startswith(HANDED_ON)] == []


# Handed on as a whole, to who takes each by its name.
HANDED_ON = ("evaluation.",)


def is_of_an_error(name: str) -> bool:
    """Whether a setting says how an error of a sensor spreads, which the default filter looks up by its name."""
    section, _, own = name.rpartition(".")
    if section != "fusion.error_state":
        return False
    value = getattr(ErrorStateSettings(), own)
    usual, other = (FilterParameters.of(ErrorStateSettings(**given)) for given in ({}, {own: value / 2}))
    return not (np.array_equal(usual.variances, other.variances) and np.array_equal(usual.walks, other.walks))


def parts_of(thing: Any, seen: set[int]) -> Iterator[Any]:
    """All objects of wheelsight that are reached from one, itself among them; not what lies within settings."""
    if id(thing) in seen:
        return
    seen.add(id(thing))
    if isinstance(thing, list | tuple):
        for one in thing:
            yield from parts_of(one, seen)
    elif type(thing).__module__.startswith("wheelsight"):
        yield thing
        names = (
            () if isinstance(thing, Settings) else (*getattr(thing, "__dict__", ()), *getattr(thing, "__slots__", ()))
        )
        for name in names:
            yield from parts_of(getattr(thing, name), seen)


def held_by(thing: Any, kind: type[Any] = Settings) -> list[Any]:
    """What an object of wheelsight holds of a kind, or what one that it holds does."""
    return [one for one in parts_of(thing, set()) if isinstance(one, kind)]


def changed(section: Settings) -> dict[str, Any]:
    """Another value of the first number of a section that may be a little more."""
    for name, about in type(section).model_fields.items():
        value = getattr(section, name)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        extra = about.json_schema_extra
        if is_number and isinstance(extra, dict) and "source" in extra:
            return {name: value + 1 if isinstance(value, int) else value * 1.01}
    raise AssertionError(section)


# What a localizer by wheels and features hands to parts as it is.
WHOLE = ("clocks", "features")
REACHED = [(name, section) for name, section in sections(Config()) if name.startswith(WHOLE)]


@pytest.mark.parametrize(("name", "section"), REACHED, ids=[name for name, _ in REACHED])
def test_a_section_reaches_who_goes_by_it(name: str, section: Settings) -> None:
    ((own, value),) = changed(section).items()
    settings = load_config(overrides={"odometry": "wheels,features", f"{name}.{own}": value})
    subject = Localizer(CALIBRATION, settings)
    subject.process(YawRate(0.0, 0.1))
    held = held_by(subject, type(section))
    assert held
    assert all(one != section for one in held)


def test_the_gap_reaches_who_goes_by_it() -> None:
    given = {"odometry": "wheels,dense", "wheels.gyro_gap_s": 0.3}
    subject = Localizer(CALIBRATION, load_config(overrides=given))
    assert {meter.gap_s for meter in held_by(subject, YawRateMeter)} == {0.3}


def test_real_time_is_played_by_the_settings() -> None:
    settings = load_config(overrides={"realtime.frames_ahead": 7}).realtime
    live = RealTimeRecording(MemoryRecording([]), settings=settings)
    assert held_by(live) == [settings]
