from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from narrowing import not_none
from run_example import empty_run, example_picture, example_run, wheel_run

from wheelsight import __version__
from wheelsight.app.run import RunRecord
from wheelsight.app.run.run_record import KnownMapRecord
from wheelsight.core.errors import OutputError
from wheelsight.evaluation import AbsoluteError, RelativeError
from wheelsight_report import write_report

ALL_PLOTS = {
    f"plot-{name}"
    for name in ("path-xy", "path-xz", "path-yz", "errors", "status", "matches", "time", "time-histogram", "stages")
}


def _page(run: RunRecord, folder: Path) -> Page:
    write_report(run, folder / "report.html")
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def _metres(text: str) -> float:
    value, unit = text.split()
    return float(value) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[unit]


def test_every_figure_has_its_place_and_its_words(tmp_path: Path) -> None:
    page = _page(example_run(200), tmp_path)
    assert set(page.plots) == ALL_PLOTS
    assert all(plot.alt and plot.spec["data"] for plot in page.plots.values())
    assert page.tags["figcaption"] == len(ALL_PLOTS)
    assert page.tags["h1"] == 1
    assert len(page.ids) == len(set(page.ids))


def test_whether_a_known_map_was_recognised_stands_first(tmp_path: Path) -> None:
    known = KnownMapRecord("monday", 0.4, 1.2, -0.3, 0.0, None, 0.02, 0.01, views=5, keyframes=9, keyframes_placed=9)
    page = _page(example_run(60, known_map=known), tmp_path)
    assert page.text.index(f"Good: {known.sentence}.") < page.text.index("Care: ")
    unknown = KnownMapRecord("monday", keyframes=9)
    page = _page(example_run(60, known_map=unknown), tmp_path)
    assert page.text.index("Do not rely on it: the place was not recognised") < page.text.index(unknown.sentence)
    assert page.text.index(f"Bad: {unknown.sentence}. To do: drive slowly past") < page.text.index("Care: ")


def test_the_headline_says_what_the_run_was(tmp_path: Path) -> None:
    page = _page(example_run(60), tmp_path)
    for fact in ("corridor with a lost while", "format tum", "T_map_camera", "2024-08-17 14:03 UTC", __version__):
        assert fact in page.text


def test_the_frame_is_that_of_the_trajectory(tmp_path: Path) -> None:
    run = example_run(60, with_truth=False)
    page = _page(replace(run, estimate=replace(run.estimate, body="base")), tmp_path)
    assert "T_map_base: poses of the robot's base (x forward" in page.text
    assert "T_map_camera" not in page.text


@pytest.mark.parametrize("seed", [1, 5])
def test_tiles_hold_the_records_numbers(seed: int, tmp_path: Path) -> None:
    run = example_run(400, seed)
    page = _page(run, tmp_path)
    rmse_m = not_none(run.evaluation).ate.translation.rmse
    second = not_none(not_none(run.evaluation).rpe_per_second)
    ms = 1e3 * np.median([f.seconds for f in run.frames if not f.is_skipped])
    posed = len(run.estimate)
    assert _metres(page.tiles["ATE, RMSE"][0]) == pytest.approx(rmse_m, rel=5e-3)
    assert _metres(page.tiles["RPE a second, RMSE"][0]) == pytest.approx(second.translation.rmse, rel=5e-3)
    assert page.tiles["RPE a second, RMSE"][1] == f"{np.degrees(second.rotation.rmse):.3f}° of rotation"
    assert page.tiles["Frames with a pose"] == (f"{posed / 4:.1f} %".replace(".0", ""), f"{posed} of 400")
    assert page.tiles["Median time a frame"][0] == f"{ms:.1f} ms"
    assert page.tiles["Distance travelled"][0] == f"{run.estimate.length_m:.1f} m"
    assert page.tiles["Duration"] == ("13.3 s", "400 frames")
    assert page.tiles["Lost episodes"][0] == "1"
    assert page.tiles["Peak memory"][0] == "312 MB"


def test_the_table_holds_the_evaluations_numbers(tmp_path: Path) -> None:
    run = example_run(400)
    page = _page(run, tmp_path)
    kinds: dict[str, AbsoluteError | RelativeError | None] = {
        "ATE": not_none(run.evaluation).ate,
        "RPE a frame": not_none(run.evaluation).rpe_per_frame,
        "RPE a metre": not_none(run.evaluation).rpe_per_metre,
    }
    for name, error in kinds.items():
        assert error is not None
        for part, s in (("translation", error.translation), ("rotation", error.rotation.in_degrees())):
            *numbers, count = page.rows[f"{name}, {part}"]
            np.testing.assert_allclose([float(n) for n in numbers], (s.rmse, s.mean, s.median, s.max, s.std), rtol=6e-4)
            assert int(count) == s.count
    assert page.text.index("RMSE [m]") < page.text.index("ATE, translation") < page.text.index("RMSE [°]")


def test_steps_that_do_not_exist_are_said_so(tmp_path: Path) -> None:
    run = example_run(100)
    page = _page(replace(run, evaluation=replace(not_none(run.evaluation), rpe_per_metre=None)), tmp_path)
    assert "RPE a metre, RMSE" not in page.tiles
    assert "no step that long" in page.rows["RPE a metre"]


def test_figures_hold_the_records_numbers(tmp_path: Path) -> None:
    run = example_run(300)
    plot = _page(run, tmp_path).plots["plot-errors"]
    drawn = plot.numbers(plot.spec["data"][0], "y")
    np.testing.assert_allclose(drawn[~np.isnan(drawn)], not_none(run.evaluation).ate.errors_m, rtol=1e-6)


def test_it_holds_all_it_needs(tmp_path: Path) -> None:
    page = _page(example_run(60, pictures=(example_picture(),)), tmp_path)
    for tag, name, value in page.attributes:
        assert not value.strip().lower().startswith(("http:", "https:", "//", "file:")), (tag, name, value)
        if name in ("src", "href", "srcset", "action", "data", "poster"):
            assert value.startswith(("data:", "#")), (tag, name, value)
    css = (Path(write_report.__code__.co_filename).parent / "style.css").read_text(encoding="utf-8")
    assert "url(" not in css
    assert "@import" not in css
    policy = next(value for _, _, value in page.attributes if value.startswith("default-src"))
    assert "default-src 'none'" in policy


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return _page(example_run(60, pictures=(example_picture(),)), tmp_path_factory.mktemp("plain"))


@pytest.mark.parametrize(
    "hostile", ["</title><script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "$title ${x} $$", "</script>"]
)
def test_hostile_names_stay_text(plain: Page, hostile: str, tmp_path: Path) -> None:
    run = example_run(60, pictures=(example_picture(),))
    frames = tuple(replace(f, note=hostile) if f.is_skipped or i == 3 else f for i, f in enumerate(run.frames))
    page = _page(
        replace(
            run,
            recording=hostile,
            format=hostile,
            warnings=(hostile,),
            config={hostile: [hostile]},
            stage_seconds={hostile: 0.001},
            frames=frames,
        ),
        tmp_path,
    )
    for tag in ("script", "img", "title", "style"):
        assert page.tags[tag] == plain.tags[tag]
    assert not any(name.startswith("on") for _, name, _ in page.attributes)
    assert page.text.count(hostile) >= 5
    assert list(page.plots["plot-stages"].spec["data"][0]["y"]) == [hostile]
    without = replace(run, evaluation=None, evaluation_problem=hostile, recording=hostile)
    assert _page(without, tmp_path).tags["script"] == plain.tags["script"] - 1  # the error figure's


def test_a_name_that_is_no_text_costs_no_page(tmp_path: Path) -> None:
    assert "corridor?" in _page(example_run(5, recording="corridor\udcff"), tmp_path).text


@pytest.mark.parametrize(
    ("run", "missing"),
    [
        (example_run(60, with_truth=False), {"plot-errors"}),
        (empty_run(), {"plot-errors", "plot-path-xy", "plot-path-xz", "plot-path-yz", "plot-stages", "plot-matches"}),
        (replace(empty_run(), frames=()), ALL_PLOTS),
        (example_run(1), {"plot-errors"}),
        (example_run(10), set()),
    ],
)
def test_what_is_not_known_is_left_out(run: RunRecord, missing: set[str], tmp_path: Path) -> None:
    page = _page(run, tmp_path)
    assert set(page.plots) == ALL_PLOTS - missing
    assert "nan" not in re.findall(r"[a-z]+", page.text.lower())
    if "plot-errors" in missing:
        assert page.tiles["ATE"] == ("unknown", "not evaluated")


def test_values_that_are_not_finite_are_unknown(tmp_path: Path) -> None:
    run = example_run(60, with_truth=False, stage_seconds={"extract": float("nan"), "match": 0.001})
    page = _page(replace(run, frames=tuple(replace(f, seconds=float("nan")) for f in run.frames)), tmp_path)
    assert page.tiles["Median time a frame"] == ("unknown", "")
    assert "plot-time" not in page.plots


def test_pictures_are_captioned_and_few(tmp_path: Path) -> None:
    picture = example_picture(np.zeros((96, 128, 3), np.uint8), 40)
    page = _page(example_run(60, pictures=(picture,) * 30), tmp_path)
    assert page.tags["img"] == 12
    assert "12 of 30 pictures are shown." in page.text
    inliers = int(picture.is_inlier.sum())
    assert f"2.00 s after the start (stamp {picture.stamp_s:.3f})" in page.text
    assert f"40 matches, {inliers} inliers ({100 * inliers / 40:.1f} %)".replace(".0 %", " %") in page.text
    assert all(value for tag, name, value in page.attributes if (tag, name) == ("img", "alt"))


def test_settings_are_shown_as_yaml(tmp_path: Path) -> None:
    page = _page(example_run(10, config={"odometry": {"keypoints": 1000, "calibration": Path("a/b.yaml")}}), tmp_path)
    assert "odometry:\n  keypoints: 1000\n  calibration: a/b.yaml" in page.text


def test_the_same_run_gives_the_same_page(tmp_path: Path) -> None:
    write_report(example_run(60), tmp_path / "a.html")
    write_report(example_run(60), tmp_path / "b.html")
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_it_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="does not exist"):
        write_report(example_run(5), tmp_path / "missing" / "report.html")
    write_report(example_run(5), tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_its_size_is_plotlys_and_little_more(tmp_path: Path) -> None:
    write_report(example_run(20_000), tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 2e6


def test_a_drive_by_wheels_shows_what_makes_sense_of_it(tmp_path: Path) -> None:
    page = _page(wheel_run(), tmp_path)
    assert set(page.plots) == {f"plot-{name}" for name in ("path-xy", "errors", "certainty", "status")}
    assert "T_odom_base: poses of the robot's base (x forward, y left, z up) in odom" in page.text
    assert page.tiles["Readings with a pose"] == ("99.5 %", "398 of 400")
    assert page.tiles["Median time a reading"][0] == "3.00 µs"
    assert "2 used readings gave no pose: implausible motion (2)." in page.text
    assert "the path goes on from where it was" in page.text
    assert "Was every reading used?" in page.text
    for of_cameras in ("camera", "image", "frame ", "frames", "lost", "matches"):
        assert of_cameras not in page.text.partition("Settings")[0].lower().replace("this page", ""), of_cameras


def test_a_drive_without_truth_still_shows_how_sure_it_was(tmp_path: Path) -> None:
    page = _page(wheel_run(with_truth=False), tmp_path)
    assert set(page.plots) == {f"plot-{name}" for name in ("path-xy", "certainty", "status")}
    assert "path in its own odom" in page.text
