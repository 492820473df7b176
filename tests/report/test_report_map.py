from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import plotly.graph_objects as go
import pytest
from html_page import Page
from hypothesis import given
from hypothesis import strategies as st
from run_example import empty_run, example_map, example_run, wheel_run

from wheelsight.app.run import MapPicture
from wheelsight_report import plan_figure, write_report
from wheelsight_report.comparison import write_comparison
from wheelsight_report.sections import bar_length_m, draw_view


def _page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def _image(uri: str) -> np.ndarray:
    kind, data = uri.split(",", 1)
    assert kind == "data:image/webp;base64"
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image[..., ::-1]


def _trace(figure: go.Figure, name: str) -> np.ndarray:
    (trace,) = (trace for trace in figure.data if trace.name == name and trace.mode == "lines")
    return np.stack([trace.x, trace.y], axis=-1).astype(float)


def test_the_plan_is_where_its_pixels_are_and_the_path_lies_on_it():
    run = example_run(200, map=example_map())
    figure = plan_figure(run)
    (image,) = figure.layout.images
    assert (image.x, image.y) == pytest.approx((-4.005, 3.005))
    assert (image.sizex, image.sizey) == pytest.approx((8.0, 6.0))
    drawn = _image(image.source)
    assert drawn.shape == (600, 800, 3)
    np.testing.assert_allclose(drawn[300, 400].astype(int), (170, 40, 30), atol=4)
    path = _trace(figure, "path")
    known = path[~np.isnan(path).any(axis=1)]
    np.testing.assert_allclose(known, run.estimate.positions_m[:, :2])
    assert np.isnan(path).any(), "no line is drawn where no pose is known"
    assert figure.layout.yaxis.scaleanchor == "x"


def test_the_path_turns_with_the_plan():
    found = example_map()
    aslant = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    assert found.plan is not None
    run = example_run(60, map=replace(found, plan=replace(found.plan, R_plan_map=aslant)))
    path = _trace(plan_figure(run), "path")
    np.testing.assert_allclose(path[~np.isnan(path).any(axis=1)], run.estimate.positions_m[:, 1:])


def test_the_bar_is_as_long_as_it_says():
    figure = plan_figure(example_run(60, map=example_map()))
    (bar,) = figure.layout.shapes
    (label,) = figure.layout.annotations
    assert bar.x1 - bar.x0 == pytest.approx(float(label.text.split()[0]))
    assert label.text == "2 m"


@given(extent_m=st.floats(1e-3, 1e5))
def test_bars_have_round_lengths(extent_m: float) -> None:
    length_m = bar_length_m(extent_m)
    assert extent_m / 10 - 1e-12 < length_m <= extent_m / 4
    assert f"{length_m:e}".split("e")[0].rstrip("0").rstrip(".") in {"1", "2", "5"}


def test_frame_and_map_stand_side_by_side(rng: np.random.Generator):
    color, rendered = np.zeros((480, 640, 3), np.uint8), np.full((240, 320, 3), 77, np.uint8)
    drawn = draw_view(MapPicture(0.0, color, rendered))
    assert drawn.shape == (480, 1286, 3)
    assert (drawn[:, :640] == 0).all()
    assert (drawn[:, 640:646] == 255).all()
    assert (drawn[:, 646:] == 77).all()


def test_the_page_shows_the_map(tmp_path: Path):
    write_report(example_run(200, map=example_map(pictures=3)), tmp_path / "report.html")
    page = _page(tmp_path)
    assert "plot-map-plan" in page.plots
    assert page.tiles["Surfels in the map"] == ("412,345", "72.8 % of them stable")
    assert "412,345 surfels (small disks) of 480 frames, 300,000 of them stable" in page.text
    assert "72 MB of memory" in page.text
    assert page.tags["img"] == 3 + 1  # and the cloud's still picture
    assert "The vertical is estimated" not in page.text


def test_a_world_that_no_one_levelled_is_said_so(tmp_path: Path):
    write_report(example_run(60, map=example_map(is_levelled=False)), tmp_path / "report.html")
    assert "The vertical is estimated from the surfels" in _page(tmp_path).text


def test_an_empty_map_is_reported_and_no_map_is_not(tmp_path: Path):
    empty = example_map(pictures=0, plan=None)
    write_report(replace(empty_run(), map=empty), tmp_path / "report.html")
    assert "It is empty: no frame had a pose." in _page(tmp_path).text
    write_report(empty_run(), tmp_path / "report.html")
    assert "The map" not in _page(tmp_path).text


def test_of_several_it_stands_under_its_odometrys_name(tmp_path: Path):
    dense = example_run(60, odometry="dense", map=example_map())
    write_comparison([replace(wheel_run(), odometry="wheels"), dense], tmp_path / "report.html")
    page = _page(tmp_path)
    assert "plot-dense-map-plan" in page.plots
    assert "Dense: the map" in page.text
    assert "are in dense/map.surfels" in page.text
    assert page.tiles["Surfels in the map"][0] == "412,345"
    assert len(page.ids) == len(set(page.ids))
