from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from area_drive import AREAS
from area_example import area_runs
from browser import open_page
from html_page import Page
from narrowing import not_none
from run_example import example_run

from wheelsight.app.run import words
from wheelsight.core.areas import Area, AreaMap
from wheelsight_report.comparison import error_rows, render_comparison, write_comparison
from wheelsight_report.comparison_figures import area_map_figure, area_time_figure, map_error_figure
from wheelsight_report.drawing import area_colour


def traces(figure: go.Figure, name: str) -> list:
    return [trace for trace in figure.data if trace.name == name]


def test_the_map_shows_areas_names_and_paths_where_they_are() -> None:
    _, record = area_runs()
    figure = area_map_figure(record)
    for index, area in enumerate(AREAS):
        (drawn,) = traces(figure, f"area {area.name}")
        np.testing.assert_array_equal(np.stack([drawn.x, drawn.y], axis=-1)[:-1], area.polygon)
        red, green, blue = (int(area_colour(index)[i : i + 2], 16) for i in (1, 3, 5))
        assert drawn.fillcolor.startswith(f"rgba({red},{green},{blue},")
    assert [a.text for a in figure.layout.annotations] == [f"<b>{area.name}</b>" for area in AREAS]
    for name, path in (
        ("ground truth", record.ground_truth),
        ("wheels", not_none(record.rectification).wheels),
        ("rectified", record.estimate),
    ):
        (line,) = traces(figure, name)
        np.testing.assert_allclose(np.stack([line.x, line.y], axis=-1), not_none(path).positions_m[:, :2])
    assert figure.layout.yaxis.scaleanchor == "x"


def test_names_of_areas_cannot_bring_html_in() -> None:
    _, record = area_runs()
    odd = AreaMap(tuple(Area(f"<b>{a.name}", a.polygon, a.x_m, a.y_m) for a in AREAS))
    record = replace(record, rectification=replace(not_none(record.rectification), areas=odd))
    assert "<b><b>" not in str(area_map_figure(record).layout.annotations)
    assert area_time_figure(record).layout.yaxis.ticktext[0].startswith("&lt;b&gt;")


def test_rows_of_areas_hold_the_probabilities_and_gaps() -> None:
    _, record = area_runs()
    figure = area_time_figure(record)
    by_itself, believed = [trace for trace in figure.data if trace.type == "heatmap"]
    np.testing.assert_array_equal(by_itself.customdata, not_none(record.rectification).forest.T)
    np.testing.assert_array_equal(believed.customdata, not_none(not_none(record.rectification).belief).T)
    assert np.isnan(by_itself.z[:, 10:13]).all()
    rows = np.floor(np.nan_to_num(by_itself.z, nan=0.0))
    assert ((rows == np.arange(len(AREAS))[:, None]) | np.isnan(by_itself.z)).all()
    assert (by_itself.yaxis, believed.yaxis) == ("y", "y2")


def test_colours_of_rows_go_from_nothing_to_the_areas_own() -> None:
    scale = area_time_figure(area_runs()[1]).data[0].colorscale
    edges = [edge for edge, _ in scale]
    assert edges == sorted(edges)
    assert (edges[0], edges[-1]) == (0, 1)
    for index in range(len(AREAS)):
        assert scale[2 * index][1].endswith(",0.05)")
        assert scale[2 * index + 1][1] == area_colour(index)


def test_the_true_area_runs_through_its_row() -> None:
    _, record = area_runs()
    truth = not_none(not_none(record.rectification).true_areas)
    for line in traces(area_time_figure(record), "true area"):
        index = np.round(
            (np.asarray(line.x) + record.frames[0].stamp_s - not_none(record.rectification).stamps_s[0]) / 0.2
        )
        drawn = np.full(len(truth), np.nan)
        for at, value in zip(index.astype(int), line.y, strict=True):  # held until the next point
            drawn[at:] = value
        np.testing.assert_array_equal(drawn, np.where(truth >= 0, truth, np.nan))


def test_the_papers_way_shows_one_panel() -> None:
    figure = area_time_figure(area_runs("paper")[1])
    assert sum(trace.type == "heatmap" for trace in figure.data) == 1
    assert not traces(figure, "trust in the model")
    assert traces(area_time_figure(area_runs()[1]), "trust in the model")


def test_an_hour_of_frames_is_thinned_to_means() -> None:
    _, record = area_runs()
    looks = not_none(record.rectification).looks
    many = tuple(replace(looks[i % len(looks)], stamp_s=looks[0].stamp_s + i / 30) for i in range(5000))
    found = replace(not_none(record.rectification), looks=many, true_areas=None, errors=None)
    heat = area_time_figure(replace(record, rectification=found)).data[0]
    assert heat.z.shape[1] == 1200
    assert np.nansum(heat.customdata, axis=0).max() == pytest.approx(1, abs=0.01)
    first = found.forest[: np.count_nonzero(np.arange(5000) * 1200 // 5000 == 0)]
    np.testing.assert_allclose(heat.customdata[:, 0], first.mean(axis=0))


def test_errors_are_those_of_the_record() -> None:
    _, record = area_runs()
    found = not_none(record.rectification)
    figure = map_error_figure(record)
    np.testing.assert_array_equal(traces(figure, "rectified")[0].y, not_none(found.errors).rectified_m)
    assert not_none(found.errors).rectified.mean == pytest.approx(0.5)
    head, rows = error_rows(found)
    assert [row[0] for row in rows] == ["wheels", "rectified"]
    assert (head[1], rows[1][1]) == ("mean [m]", "0.500")  # the wheels err by metres: one unit a column
    assert float(rows[0][1]) == pytest.approx(not_none(found.errors).wheels.mean, abs=5e-4)
    assert error_rows(not_none(area_runs(with_truth=False)[1].rectification)) == ((), [])


def test_accuracy_counts_frames_that_say_something_and_have_a_true_area() -> None:
    found = not_none(area_runs()[1].rectification)
    judged = int(found.is_judged.sum())
    assert judged == np.count_nonzero(not_none(found.true_areas) >= 0) - 3
    assert found.accuracy(found.forest) == pytest.approx(1 - 1 / judged)
    assert np.isnan(not_none(area_runs(with_truth=False)[1].rectification).accuracy(found.forest))


def test_the_page_shows_what_areas_did() -> None:
    page = Page(render_comparison(area_runs()))
    assert {"plot-area-map", "plot-area-time", "plot-map-error", "plot-overlay"} <= set(page.plots)
    found = not_none(area_runs()[1].rectification)
    assert f"Areas bring the wheels from {not_none(found.errors).wheels.mean:.2f} m to 50.0 cm off (mean)" in page.text
    assert page.tiles["In the map, mean error"][0] == "50.0 cm"
    assert "3 frames gave no probabilities: the frame has no depth (3)." in page.text
    assert "The model was not trusted in" in page.text
    assert "The start is the one that was given" in page.text
    assert "the camera was never lost" not in page.text


def test_areas_that_do_harm_are_not_praised() -> None:
    wheels, record = area_runs()
    found = not_none(record.rectification)
    swapped = replace(
        not_none(found.errors),
        wheels_m=not_none(found.errors).rectified_m,
        rectified_m=not_none(found.errors).wheels_m,
    )
    page = Page(render_comparison([wheels, replace(record, rectification=replace(found, errors=swapped))]))
    left = words.percent(not_none(found.errors).wheels.mean / not_none(found.errors).rectified.mean)
    assert f"rectified: areas leave {left} of the error" in page.text
    assert "wheelsight places train" in page.text


def test_without_truth_the_page_says_so_and_draws_the_rest() -> None:
    page = Page(render_comparison(area_runs(with_truth=False)))
    assert {"plot-area-map", "plot-area-time"} <= set(page.plots)
    assert "plot-map-error" not in page.plots
    assert "Without a ground truth, how far off either is cannot be said." in page.text
    assert "In the map, mean error" not in page.tiles


def test_a_run_without_places_has_no_such_section() -> None:
    wheels, _ = area_runs()
    page = Page(render_comparison([wheels, example_run(60)]))
    assert "plot-area-map" not in page.plots


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.parametrize("way", ["probabilistic", "paper"])
def test_a_browser_draws_every_figure(way: str, chromium: str, tmp_path: Path) -> None:
    write_comparison(area_runs(way), tmp_path / "report.html")
    expected = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    dom, console = open_page(chromium, tmp_path / "report.html")
    assert console == []
    for key, plot in Page(dom).plots.items():
        assert plot.svg_sizes_px, f"{key} was not drawn"
        lines = [trace for trace in expected.plots[key].spec["data"] if trace["type"] != "heatmap"]
        assert len(plot.drawn) == len(lines), key
    heatmaps = 2 if way == "probabilistic" else 1
    assert dom.count('class="hm"') == heatmaps
    assert len(re.findall(r'<image[^>]*href="data:image/png', dom)) == heatmaps
