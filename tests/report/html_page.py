"""A page taken apart: what tests ask of a report's HTML, before and after a browser has drawn it."""

from __future__ import annotations

import base64
import json
from collections import Counter
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import numpy as np

_VOID = {"meta", "link", "img", "br", "hr", "input"}


@dataclass
class Plot:
    """One figure's place, the specification that follows it, and what the browser drew there."""

    alt: str
    spec: dict[str, Any] = field(default_factory=dict)
    svg_sizes_px: list[tuple[float, float]] = field(default_factory=list)
    drawn: list[int] = field(default_factory=list)  # for each trace: how many marks or lines with some extent

    def numbers(self, trace: dict[str, Any], axis: str) -> np.ndarray:
        """A trace's values as floats: plotly writes arrays as base64, lists with null for what is unknown."""
        values = trace[axis]
        if isinstance(values, dict):
            return np.frombuffer(base64.b64decode(values["bdata"]), np.dtype(values["dtype"])).astype(float)
        return np.array([np.nan if value is None else value for value in values], float)


class Page(HTMLParser):
    """Everything of one HTML text that tests look at."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str, str]] = []
        self.ids: list[str] = []
        self.plots: dict[str, Plot] = {}
        self.tiles: dict[str, tuple[str, str]] = {}
        self.rows: dict[str, list[str]] = {}
        self.text = ""
        self._open: list[tuple[str, dict[str, str]]] = []
        self._plot: Plot | None = None
        self._tile = ["", "", ""]
        self._row: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        held = {name: value or "" for name, value in attrs}
        self.tags[tag] += 1
        self.attributes += [(tag, name, value) for name, value in held.items()]
        if "id" in held:
            self.ids.append(held["id"])
        if held.get("class", "").split()[:1] == ["plot"]:
            self._plot = self.plots[held["id"]] = Plot(held.get("aria-label", ""))
        if tag not in _VOID:
            self._open.append((tag, held))
        self._note_drawing(tag, held)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in _VOID:
            return
        while self._open and self._open.pop()[0] != tag:
            pass
        if tag == "div" and self._tile[0]:
            self.tiles[self._tile[0]] = (self._tile[1], self._tile[2])
            self._tile = ["", "", ""]
        if tag == "tr" and self._row:
            self.rows[self._row[0]] = self._row[1:]
            self._row = []

    def handle_data(self, data: str) -> None:
        tag, held = self._open[-1] if self._open else ("", {})
        if tag == "script" and held.get("type") == "application/json":
            assert self._plot is not None
            self._plot.spec = json.loads(data, parse_constant=_refuse)
        elif tag == "dt":
            self._tile[0] = data
        elif tag == "dd":
            self._tile[2 if held["class"] == "more" else 1] = data
        elif tag in ("th", "td") or (tag == "a" and self._open[-2][0] in ("th", "td")):
            self._row.append(data)
        if tag not in ("script", "style"):
            self.text += data

    def _note_drawing(self, tag: str, held: dict[str, str]) -> None:
        if self._plot is None or not any(h.get("class", "").startswith("plot") for _, h in self._open):
            return
        kinds = held.get("class", "").split()
        if tag == "svg" and "main-svg" in kinds:
            self._plot.svg_sizes_px.append((float(held["width"]), float(held["height"])))
        if tag == "g" and "trace" in kinds:
            self._plot.drawn.append(0)
        inside_trace = any("trace" in h.get("class", "").split() for _, h in self._open)
        if tag == "path" and inside_trace and len(held.get("d", "")) > 4:
            self._plot.drawn[-1] += 1


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not JSON")
