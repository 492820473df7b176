"""The pages about places: what they hold, and, in a browser, what a person's clicks and keys make of a sheet."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from browser import open_page
from html_page import Page
from places_example import NAMES, example_model, example_sheet, example_trial

from wheelsight.core.errors import OutputError
from wheelsight_papers import ContactSheet, PlaceTrial, read_labels
from wheelsight_papers.places_page import render_sheet, write_places_page, write_sheet
from wheelsight_report.drawing import area_colour


def trial_page(trial: PlaceTrial, tmp_path: Path) -> Page:
    write_places_page(trial, example_model(), "drive <2>", tmp_path / "trial.html")
    return Page((tmp_path / "trial.html").read_text(encoding="utf-8"))


def test_a_trial_page_holds_the_figures_of_the_trial(tmp_path: Path) -> None:
    trial = example_trial()
    page = trial_page(trial, tmp_path)
    assert set(page.plots) == {"plot-confusion", "plot-time", "plot-reliability"}
    assert page.tiles["Accuracy"] == ("88.9 %", "held out in training 91 %")
    assert page.tiles["Least of an area"] == ("66.7 %", "area hall")
    assert page.tiles["Calibration error"][0] == f"{trial.curve.error:.3f}"
    assert page.rows["hall"][:2] == ["30", "66.7 %"]
    assert "Most often area hall is taken for 1: 10 frames." in page.text
    assert "15.0 s: in hall, taken for 1, 90 % sure." in page.text
    assert "no depth" not in page.text


def test_the_confusion_matrix_is_drawn_by_shares_of_its_rows(tmp_path: Path) -> None:
    page = trial_page(example_trial(blind=True), tmp_path)
    (heat,) = page.plots["plot-confusion"].spec["data"]
    assert heat["text"] == [["27", "", "", "3"], ["", "30", "", ""], ["10", "", "20", ""]]
    ticks = page.plots["plot-confusion"].spec["layout"]["yaxis"]["ticktext"]
    assert ticks == ["1", "&lt;lift&gt; &amp; co", "hall"]
    assert "3 frames have no depth and count as wrong." in page.text


def test_a_perfect_trial_has_no_mistakes_to_show(tmp_path: Path) -> None:
    page = trial_page(example_trial(perfect=True), tmp_path)
    assert page.tiles["Accuracy"][0] == "100 %"
    assert "None: every frame was taken for its own area." in page.text
    assert page.tags["img"] == 0


def test_pages_refer_to_nothing_outside_themselves(tmp_path: Path) -> None:
    write_sheet(example_sheet(), tmp_path / "sheet.html", "labels.csv")
    write_places_page(example_trial(), example_model(), "a", tmp_path / "trial.html")
    for name in ("sheet.html", "trial.html"):
        page = Page.__new__(Page)
        text = (tmp_path / name).read_text(encoding="utf-8")
        if name == "sheet.html":  # its data belong to no plot
            text = re.sub(r'<script type="application/json".*?</script>', "", text, flags=re.S)
        page.__init__(text)  # type: ignore[misc]
        sources = [value for _, attribute, value in page.attributes if attribute in ("src", "href")]
        assert all(value.startswith(("data:", "#")) for value in sources)
        assert len(page.ids) == len(set(page.ids))


def test_a_sheet_holds_its_data_and_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    html = render_sheet(example_sheet(), "labels <1>.csv")
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.S)[1])  # type: ignore[index]
    assert data["borders"][:2] == ["100.000000", "101.000000"]
    assert data["labels"] == [0] * 4 + [1] * 4 + [-1] * 4
    assert (data["names"], data["file"]) == (list(NAMES), "Küche__1_-labels.csv")
    assert len(data["pictures"]) == 12
    assert "proposed areas: labels &lt;1&gt;.csv" in html
    assert area_colour(0) == area_colour(len(data["colours"]))
    with pytest.raises(OutputError, match="does not exist"):
        write_sheet(example_sheet(), tmp_path / "missing" / "sheet.html")


# In the browser. A test's script acts as a person does; what would be saved and what is shown go to the document.

_HARNESS = """
<pre id="outcome"></pre>
<script>
"use strict";
(async () => {
  let saved = "";
  URL.createObjectURL = (blob) => { saved = blob; return "blob:none"; };
  HTMLAnchorElement.prototype.click = function () { this.dataset.clicked = this.download; };
  const thumbs = [...document.querySelectorAll(".thumb")];
  const pointer = (kind, target, more) => {
    const box = target.getBoundingClientRect();
    const place = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
    target.dispatchEvent(new PointerEvent(kind, { bubbles: true, pointerType: "mouse", ...place, ...more }));
  };
  const click = (i, more) => { pointer("pointerdown", thumbs[i], more); pointer("pointerup", thumbs[i], more); };
  const drag = (from, to) => {
    pointer("pointerdown", thumbs[from]);
    pointer("pointermove", thumbs[to]);
    pointer("pointerup", thumbs[to]);
  };
  const key = (name, more) => {
    const pressed = { key: name, bubbles: true, cancelable: true, ...more };
    document.body.dispatchEvent(new KeyboardEvent("keydown", pressed));
  };
  const press = (id) => document.getElementById(id).click();
  const area = (i) => document.querySelectorAll(".area")[i].click();
  const add = (name) => {
    document.querySelector(".add input").value = name;
    document.querySelector(".add").requestSubmit();
  };
  ACTIONS
  press("save");
  const shown = thumbs.map((thumb) => thumb.querySelector("b").textContent);
  const chosen = thumbs.map((thumb) => (thumb.classList.contains("chosen") ? 1 : 0)).join("");
  const runs = [...document.querySelectorAll(".strip .run")].map((run) => run.textContent);
  const dots = document.querySelectorAll("#plan .chosen").length;
  const csv = saved ? await saved.text() : "";
  const status = document.getElementById("status").textContent;
  document.getElementById("outcome").textContent = JSON.stringify({ csv, shown, chosen, runs, dots, status });
})();
</script>
</body>
"""

Play = Callable[..., dict]


@pytest.fixture
def play(chromium: str, tmp_path: Path) -> Play:
    """Opens a sheet, acts, and hands back what came of it."""

    def act(actions: str, sheet: ContactSheet | None = None) -> dict:
        path = tmp_path / "sheet.html"
        html = render_sheet(sheet or example_sheet())
        path.write_text(html.replace("</body>", _HARNESS.replace("ACTIONS", actions)), encoding="utf-8")
        dom, console = open_page(chromium, path)
        assert console == []
        text = re.search(r'<pre id="outcome">(.*?)</pre>', dom, re.S)[1]  # type: ignore[index]
        return json.loads(text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))

    return act


def labels_in(csv: str, tmp_path: Path, names: tuple[str, ...] = NAMES) -> list[int]:
    path = tmp_path / "saved.csv"
    path.write_text(csv, encoding="utf-8")
    return read_labels(path).of_frames(100.5 + np.arange(12), names).tolist()


@pytest.mark.browser
@pytest.mark.slow
class TestInTheBrowser:
    def test_left_as_it_is_it_saves_what_was_proposed(self, play: Play, tmp_path: Path) -> None:
        done = play("")
        assert done["csv"] == "from_s,to_s,area\n100.000000,104.000000,1\n104.000000,108.000000,<lift> & co\n"
        assert done["runs"] == ["1", "<lift> & co", ""]
        assert done["shown"] == ["1"] * 4 + ["<lift> & co"] * 4 + ["none"] * 4
        assert done["chosen"] == "100000000000"
        assert done["dots"] == 1

    def test_a_drag_and_a_key_name_a_part_of_the_drive(self, play: Play, tmp_path: Path) -> None:
        done = play("drag(10, 8); key('3'); drag(2, 5); area(2);")
        assert labels_in(done["csv"], tmp_path) == [0, 0, 2, 2, 2, 2, 1, 1, 2, 2, 2, -1]
        assert (done["chosen"], done["dots"]) == ("001111000000", 4)

    def test_shift_goes_on_behind_what_was_named(self, play: Play, tmp_path: Path) -> None:
        done = play("click(0); click(2, { shiftKey: true }); key('3'); click(6, { shiftKey: true }); key('1');")
        assert labels_in(done["csv"], tmp_path) == [2, 2, 2, 0, 0, 0, 0, 1, -1, -1, -1, -1]

    def test_a_wrong_key_is_mended_by_the_right_one(self, play: Play, tmp_path: Path) -> None:
        done = play("drag(8, 11); key('1'); key('3');")
        assert labels_in(done["csv"], tmp_path)[8:] == [2, 2, 2, 2]

    def test_undo_and_redo_walk_through_what_was_done(self, play: Play, tmp_path: Path) -> None:
        acts = "drag(8, 11); key('1'); drag(0, 3); key('3'); key('0');"
        assert labels_in(play(acts)["csv"], tmp_path) == [-1] * 4 + [1] * 4 + [0] * 4
        done = play(acts + "key('z', { ctrlKey: true }); press('undo'); press('undo'); press('undo'); press('redo');")
        assert labels_in(done["csv"], tmp_path) == [0] * 4 + [1] * 4 + [0] * 4
        done = play(acts + "press('undo'); press('undo'); key('y', { ctrlKey: true });")
        assert labels_in(done["csv"], tmp_path) == [2] * 4 + [1] * 4 + [0] * 4

    def test_keys_alone_are_enough(self, play: Play, tmp_path: Path) -> None:
        done = play("key('n'); key('ArrowRight', { shiftKey: true }); key('3'); key('ArrowRight'); key('1'); key('9');")
        assert labels_in(done["csv"], tmp_path) == [0] * 4 + [1] * 4 + [2, 2, 0, -1]
        done = play("key('a', { ctrlKey: true }); key('2'); key('ArrowLeft'); key('Delete');")
        assert labels_in(done["csv"], tmp_path) == [-1] + [1] * 11

    def test_without_areas_a_person_names_them(self, play: Play, tmp_path: Path) -> None:
        sheet = example_sheet(names=(), with_areas=False)
        done = play(
            """key('1'); add('lobby, "main"'); add('lobby, "main"'); add('attic'); drag(3, 6); key('1');
            click(11); key('2');""",
            sheet,
        )
        assert done["csv"].splitlines()[1:] == [
            '103.000000,107.000000,"lobby, ""main"""',
            "111.000000,112.000000,attic",
        ]
        assert labels_in(done["csv"], tmp_path, ("attic", 'lobby, "main"')) == [-1] * 3 + [1] * 4 + [-1] * 4 + [0]

    def test_nothing_named_is_not_saved(self, play: Play) -> None:
        done = play("", example_sheet(names=(), with_areas=False))
        assert (done["csv"], done["status"]) == ("", "nothing to save: no thumbnail has an area yet")

    @pytest.mark.parametrize("trial", [example_trial(), example_trial(blind=True), example_trial(3, perfect=True)])
    def test_every_figure_of_a_trial_is_drawn(self, trial: PlaceTrial, chromium: str, tmp_path: Path) -> None:
        trial_page(trial, tmp_path)
        dom, console = open_page(chromium, tmp_path / "trial.html")
        assert console == []
        page = Page(dom)
        assert len(page.plots) == 3
        for key, plot in page.plots.items():
            assert plot.svg_sizes_px, f"{key} was not drawn"
        drawn = int((trial.confusion > 0).sum())
        assert len(re.findall(r'<g class="heatmap-label"><text', dom)) == drawn
