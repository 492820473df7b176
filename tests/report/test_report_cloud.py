"""The map to be turned: what the page holds of it, what a browser draws, and the picture for who cannot turn it."""

from __future__ import annotations

import base64
import itertools
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browser import WITH_WEBGL, WITHOUT_WEBGL, open_page
from html_page import Page
from run_example import example_cloud, example_map, example_run

from wheelsight.app.run import RunRecord
from wheelsight.core.geometry import FloatArray
from wheelsight.mapping.plan import MapCloud
from wheelsight_report import write_report
from wheelsight_report.pictures import OrbitView, draw_cloud

SCRIPTS = Path(__file__).resolve().parents[2] / "wheelsight_report"
NO_LINES = np.zeros((0, 2, 3))


def mapped() -> RunRecord:
    return example_run(200, map=example_map())


def reported_in(page: Page) -> dict[str, Any]:
    (reported,) = (value for _, name, value in page.attributes if name == "data-cloud")
    return dict(json.loads(reported))


def unpacked(text: str) -> bytes:
    (packed,) = re.findall(r'</canvas></div><script type="text/plain">([^<]*)</script>', text)
    return zlib.decompress(base64.b64decode(packed))


def test_points_colours_and_normals_come_back(tmp_path: Path) -> None:
    write_report(mapped(), tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    reported, data, cloud = reported_in(Page(text)), unpacked(text), example_cloud()
    n, ends = reported["points"], 2 * (reported["path"] + reported["loops"])
    assert n == len(cloud)
    rest = data[12 * ends :]
    level = np.frombuffer(rest[: 6 * n], "<u2").reshape(3, n).cumsum(axis=1, dtype=np.uint16).T
    np.testing.assert_allclose(
        reported["low"] + reported["step"] * level.astype(float), cloud.position, atol=reported["step"]
    )
    assert reported["step"] < 0.001
    color, normal = np.frombuffer(rest[6 * n :], np.uint8).reshape(2, 3, n).cumsum(axis=2, dtype=np.uint8)
    np.testing.assert_array_equal(color.T, cloud.color)
    np.testing.assert_allclose(normal.T.astype(np.int8) / 127, cloud.normal, atol=0.01)


def test_the_path_is_drawn_where_it_is_known_alone(tmp_path: Path) -> None:
    run = mapped()
    write_report(run, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    reported = reported_in(Page(text))
    steps = np.frombuffer(unpacked(text)[: 24 * reported["path"]], "<f4").reshape(-1, 2, 3)
    assert 0 < len(steps) < len(run.estimate) - 1, "none leads over the time in which it was lost"
    known = {tuple(p) for p in run.estimate.positions_m.astype(np.float32).tolist()}
    assert {tuple(p) for p in steps.reshape(-1, 3).tolist()} <= known


def test_the_caption_says_what_was_left_out(tmp_path: Path) -> None:
    write_report(mapped(), tmp_path / "report.html")
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text
    assert "6,400 points: the 300,000 stable surfels, averaged in cubes of 10.0 cm" in " ".join(text.split())
    write_report(example_run(60, map=example_map(cloud=None)), tmp_path / "none.html")
    assert "data-cloud" not in (tmp_path / "none.html").read_text(encoding="utf-8").partition("<footer>")[0]


def test_the_viewer_is_small_and_a_full_page_is_under_3_mb(tmp_path: Path) -> None:
    assert (SCRIPTS / "cloud.js").stat().st_size < 10_000
    rng = np.random.default_rng(3)
    noise = rng.uniform(-5, 5, (60_000, 3)).astype(np.float32)
    color = rng.integers(0, 255, (60_000, 3), np.uint8)
    cloud = MapCloud(noise, noise / np.linalg.norm(noise, axis=1, keepdims=True), color, 0.05, 10**6)
    write_report(example_run(20_000, map=example_map(cloud=cloud, pictures=4)), tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 3e6


def test_a_view_is_a_camera_that_looks_at_the_middle() -> None:
    view = OrbitView.of(example_cloud().position.astype(float), np.zeros((0, 3)))
    np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view.axes) == pytest.approx(1)
    ((u, v, depth),) = view.project(view.centre[None])
    assert (u, v, depth) == pytest.approx((480, 280, view.distance_m))
    above = view.project(view.centre[None] + [[0, 0, 0.5]])[0]
    assert above[1] < v, "up is up"
    from_above = replace(view, yaw_rad=0.0, pitch_rad=np.pi / 2)
    right, north = from_above.project(view.centre + np.array([[1.0, 0, 0], [0, 1, 0]]))
    assert right[0] > u
    assert north[1] < v


def test_surfaces_are_seen_from_their_front_alone() -> None:
    cloud, view = example_cloud(), OrbitView.of(example_cloud().position.astype(float), np.zeros((0, 3)))
    position = cloud.position.astype(float)

    def green(seen_from: OrbitView) -> int:
        image = draw_cloud(seen_from, position, cloud, np.eye(3), NO_LINES, NO_LINES).astype(int)
        return int((image[..., 1] - image[..., 0] > 50).sum())

    assert green(view) > 1000
    assert green(replace(view, yaw_rad=view.yaw_rad + np.pi)) == 0


def ways_of(page: Page) -> list[str]:
    return [value for tag, name, value in page.attributes if tag == "div" and name == "class" and "cloud" in value]


# What a reader does, and what the canvas shows after each: at first, turned, nearer, moved, from above, at home again.
# Frames are asked for of the clock, since a browser whose time runs ahead draws hardly any.
HANDS = """<script>requestAnimationFrame = (draw) => setTimeout(draw, 0);
addEventListener("load", () => setTimeout(async () => {
  const canvas = document.querySelector(".cloud canvas"), shots = [];
  if (!canvas.parentNode.dataset.drawn) return;
  const shoot = () => new Promise((done) => setTimeout(() => done(shots.push(canvas.toDataURL())), 300));
  const press = (key, shiftKey = false) => canvas.dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey }));
  const point = (kind, clientX) => canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, clientX, clientY: 9 }));
  canvas.setPointerCapture = () => {};
  await shoot();
  for (const act of [
    () => press("ArrowLeft"), () => press("+"), () => press("ArrowUp", true),
    () => ["pointerdown", "pointermove", "pointerup"].forEach((kind, k) => point(kind, 40 * k)),
    () => document.querySelectorAll(".cloud button")[1].click(), () => press("Home"),
  ]) { act(); await shoot(); }
  document.body.dataset.shots = shots.join(" ");
}, 1500));</script>"""


@pytest.mark.browser
@pytest.mark.slow
def test_a_browser_draws_it_as_the_picture_and_hands_turn_it(chromium: str, tmp_path: Path) -> None:
    page = opened(chromium, tmp_path, WITH_WEBGL)
    assert ways_of(page) == ["cloud live"]
    (reported,) = (value for _, name, value in page.attributes if name == "data-shots")
    shots = [image_of(uri) for uri in reported.split()]
    still = image_of(next(value for tag, name, value in page.attributes if tag == "img" and name == "src"))
    drawn = cv2.resize(shots[0], (still.shape[1], still.shape[0]), interpolation=cv2.INTER_AREA)
    assert (still < 250).any(axis=2).mean() > 0.1
    assert np.mean(np.abs(drawn - still).max(axis=2) > 60) < 0.03
    changed = [np.mean(np.abs(a - b).max(axis=2) > 30) for a, b in itertools.pairwise(shots)]
    assert min(changed) > 0.01, changed
    np.testing.assert_array_equal(shots[0], shots[-1])


@pytest.mark.browser
@pytest.mark.slow
def test_without_webgl_the_picture_stays(chromium: str, tmp_path: Path) -> None:
    assert ways_of(opened(chromium, tmp_path, WITHOUT_WEBGL)) == ["cloud"]


def opened(chromium: str, folder: Path, flags: tuple[str, ...]) -> Page:
    path = folder / "report.html"
    write_report(mapped(), path)
    path.write_text(path.read_text(encoding="utf-8").replace("</body>", HANDS + "</body>"), encoding="utf-8")
    dom, console = open_page(chromium, path, flags)
    assert console == []
    return Page(dom)


def image_of(uri: str) -> FloatArray:
    image = cv2.imdecode(np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, float)
