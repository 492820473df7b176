"""What stands round the figures: contents, three lines, links to files, first frames left out, the library."""

from __future__ import annotations

import base64
import hashlib
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
from html_page import Page, Plot
from joined_example import joined_runs
from run_example import example_map, example_run, wheel_run

from wheelsight_report import time_figure, time_histogram_figure, write_report
from wheelsight_report.comparison import write_comparison

SCRIPTS = Path(__file__).resolve().parents[2] / "wheelsight_report"
# Of plotly.js-cartesian-dist-min 4.1.1 on npm.
SHA256 = "79542150855a52c567260e3137095dbe2b744e6d702a5cabe67da246942fba7a"


def read(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def test_the_library_is_the_one_that_was_published_and_the_page_holds_it(tmp_path: Path) -> None:
    library = (SCRIPTS / "plotly-cartesian.min.js").read_bytes()
    assert hashlib.sha256(library).hexdigest() == SHA256
    assert b"MIT" in (SCRIPTS / "plotly-cartesian.LICENSE.txt").read_bytes()
    write_report(example_run(30), tmp_path / "report.html")
    (held,) = re.findall(r'id="plotly">([^<]*)<', read(tmp_path))
    assert zlib.decompress(base64.b64decode(held)) == library


def test_contents_lead_to_every_section(tmp_path: Path) -> None:
    write_report(example_run(120, map=example_map()), tmp_path / "report.html")
    page = Page(read(tmp_path))
    led_to = [value for tag, name, value in page.attributes if tag == "a" and name == "href"]
    headings = [value for tag, name, value in page.attributes if tag == "h2" and name == "id"]
    assert led_to == [f"#{key}" for key in headings if key != "verdict"]
    assert len(led_to) >= 7


def test_the_verdict_is_three_lines(tmp_path: Path) -> None:
    for records in ([example_run(200)], joined_runs(), [replace(wheel_run(), odometry="wheels"), example_run(200)]):
        if len(records) == 1:
            write_report(records[0], tmp_path / "report.html")
        else:
            write_comparison(records, tmp_path / "report.html")
        (verdict,) = re.findall(r'aria-labelledby="verdict">.*?<p>(.*?)</p>', read(tmp_path), re.DOTALL)
        lines = verdict.split("<br>")
        assert 2 <= len(lines) <= 3
        assert all(len(line.strip()) < 130 for line in lines), lines
    assert "Wheels: a pose in 99.5 % of readings" in verdict


def test_it_links_what_lies_beside_it_and_nothing_else(tmp_path: Path) -> None:
    write_report(example_run(30), tmp_path / "report.html")
    assert 'id="files"' not in read(tmp_path)
    (tmp_path / "trajectory.txt").write_bytes(bytes(1234))
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "map.json").write_bytes(bytes(5_000_000))
    (tmp_path / "secret.txt").write_text("not a result")
    write_report(example_run(30), tmp_path / "report.html")
    page = Page(read(tmp_path))
    links = [value for tag, name, value in page.attributes if tag == "a" and not value.startswith("#")]
    assert links == ["trajectory.txt", "map/"]
    assert "Size [kB]" in page.text
    assert page.rows["trajectory.txt"][0] == "1.23"
    assert page.rows["map/"][0] == "5,000.00"
    (tmp_path / "wheels").mkdir()
    (tmp_path / "wheels" / "trajectory.txt").write_bytes(bytes(10))
    write_comparison([replace(wheel_run(), odometry="wheels"), example_run(60)], tmp_path / "report.html")
    assert Page(read(tmp_path)).rows["wheels/trajectory.txt"][0] == "0.01"


def test_first_frames_that_compiled_are_reported_and_not_drawn(tmp_path: Path) -> None:
    run = example_run(300)  # its first frame takes 1.31 s, others 10 ms
    drawn_ms = np.concatenate([np.array(trace.y, float) for trace in time_figure(run).data])
    assert np.nanmax(drawn_ms) < 100
    used = sum(not frame.is_skipped for frame in run.frames)
    assert sum(time_histogram_figure(run).data[0].y) == used - 1
    write_report(run, tmp_path / "report.html")
    assert "The first frame, which took 1.31 s, is not drawn" in Page(read(tmp_path)).text
    late = replace(run, frames=(*run.frames[1:100], replace(run.frames[0], index=100), *run.frames[100:]))
    assert any("slower" in str(trace.name) for trace in time_figure(late).data), "later ones are"


def test_figures_hold_no_more_digits_than_one_sees(tmp_path: Path) -> None:
    far = example_run(300, with_truth=False)
    T = np.array(far.estimate.T_frame_body)
    T[:, :3, 3] += (5.4e6, 4.4e6, 0)  # as in a national grid: single precision would round to half a metre
    write_report(replace(far, estimate=replace(far.estimate, T_frame_body=T)), tmp_path / "report.html")
    plot = Page(read(tmp_path)).plots["plot-path-xy"]
    assert kinds_of(plot) == {"f8"}
    write_report(example_run(300), tmp_path / "report.html")
    assert kinds_of(Page(read(tmp_path)).plots["plot-path-xy"]) == {"f4"}


def kinds_of(plot: Plot) -> set[str]:
    """Of the arrays of its lines."""
    lines = [trace for trace in plot.spec["data"] if trace["mode"] == "lines"]
    return {line[axis]["dtype"] for line in lines for axis in "xy"}
