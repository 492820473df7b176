from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import open_page
from html_page import Page, Plot
from joined_example import joined_runs
from run_example import empty_run, example_map, example_picture, example_run, wheel_run

from wheelsight.app.run import RunRecord
from wheelsight_report import write_report
from wheelsight_report.comparison import write_comparison

pytestmark = [pytest.mark.browser, pytest.mark.slow]

RUNS = {
    "with everything": lambda: example_run(pictures=(example_picture(),)),
    "without ground truth": lambda: example_run(120, with_truth=False),
    "without any pose": empty_run,
    "with a map": lambda: example_run(120, map=example_map()),
    "of one frame and its map": lambda: example_run(1, map=example_map()),
    "of one frame": lambda: example_run(1),
    "of no frame": lambda: replace(empty_run(), frames=()),
    "of 20 000 frames": lambda: example_run(20_000),
}


@pytest.mark.parametrize("name", RUNS)
def test_every_figure_is_drawn_and_the_console_stays_silent(name: str, chromium: str, tmp_path: Path) -> None:
    expected = _written(RUNS[name](), tmp_path / "report.html")
    dom, console = open_page(chromium, tmp_path / "report.html")
    page = Page(dom)
    assert console == []
    assert set(page.plots) == set(expected.plots)
    for key, plot in page.plots.items():
        assert plot.svg_sizes_px, f"{key} was not drawn"
        assert min(min(size) for size in plot.svg_sizes_px) > 50, key
        assert len(plot.drawn) == _visible_traces(expected.plots[key]), key
        assert all(plot.drawn), f"{key} has a trace without a mark"


@pytest.mark.parametrize("with_truth", [True, False])
@pytest.mark.parametrize("joined", [True, False])
def test_every_figure_of_a_comparison_is_drawn(joined: bool, with_truth: bool, chromium: str, tmp_path: Path) -> None:
    records = [replace(wheel_run(with_truth=with_truth), odometry="wheels"), example_run(300, with_truth=with_truth)]
    if joined:
        records = [*joined_runs(with_truth, map=example_map())]
    write_comparison(records, tmp_path / "report.html")
    expected = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    dom, console = open_page(chromium, tmp_path / "report.html")
    assert console == []
    for key, plot in Page(dom).plots.items():
        assert len(plot.drawn) == _visible_traces(expected.plots[key]), key
        assert all(plot.drawn), f"{key} has a trace without a mark"


def test_a_page_that_errs_is_found_out(chromium: str, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    _written(example_run(30), path)
    text = path.read_text(encoding="utf-8")
    broken = text.replace("Plotly.newPlot(plot", "Plotly.noSuchPlot(plot")
    path.write_text(broken.replace("</main>", '<img src="https://example.invalid/a.png"></main>'), encoding="utf-8")
    dom, console = open_page(chromium, path)
    assert any("noSuchPlot" in line for line in console)
    assert any("Content Security Policy" in line for line in console)
    assert not any(plot.svg_sizes_px for plot in Page(dom).plots.values())


def _written(record: RunRecord, path: Path) -> Page:
    write_report(record, path)
    return Page(path.read_text(encoding="utf-8"))


def _visible_traces(plot: Plot) -> int:
    """How many traces have something to show, those left out that only the legend turns on."""
    shown = [trace for trace in plot.spec["data"] if trace.get("visible", True) is True]
    return sum(bool(np.isfinite(plot.numbers(trace, "x")).any()) for trace in shown)
