"""The contact sheet: one HTML page on which a person says which area each part of a drive is in, and saves that."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import cv2
import numpy as np

from wheelsight._version import __version__
from wheelsight.files import StrPath, write_text
from wheelsight.geometry import ByteArray
from wheelsight.pipeline import words
from wheelsight.places.contact_sheet import ContactSheet

# Told apart by number and name too; the first eight are neighbours on the colour circle as little as can be.
AREA_COLOURS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#8E63B5",
    "#B8A800",
    "#6B4F3A",
    "#2F9E9E",
    "#C25B5B",
    "#7A869A",
)
_JPEG_QUALITY = 80


def write_sheet(sheet: ContactSheet, path: StrPath, source: str = "") -> None:
    """Write the page to `path`, atomically; it needs no network, and a file opened by a double click serves.

    Args:
        sheet: what to show.
        path: of the page.
        source: where the proposed areas come from, in a few words; "" where nothing is proposed.

    Raises:
        OutputError: it cannot be written.
    """
    path = Path(path)
    write_text(path, render_sheet(sheet, source).encode("utf-8", "replace").decode("utf-8"))


def render_sheet(sheet: ContactSheet, source: str = "") -> str:
    """The page as HTML that refers to nothing outside itself."""
    duration_s = float(sheet.borders_s[-1] - sheet.borders_s[0])
    facts = [
        words.count(sheet.frame_count, "frame"),
        words.duration(duration_s),
        f"a thumbnail every {words.duration(sheet.every_s)}",
        f"proposed areas: {source}" if source else "no areas proposed",
        f"wheelsight {__version__}",
    ]
    data = json.dumps(_data(sheet), ensure_ascii=False).replace("<", "\\u003c")
    return Template(_asset("sheet.html")).substitute(
        title=escape(sheet.name),
        facts=" · ".join(escape(fact) for fact in facts),
        style=_asset("style.css") + _asset("sheet.css"),
        data=data,
        script=_asset("sheet.js"),
    )


def area_colour(index: int) -> str:
    """The colour of an area by its index; after twelve they begin again."""
    return AREA_COLOURS[index % len(AREA_COLOURS)]


def jpeg_uri(color: ByteArray) -> str:
    """An image (H, W, 3) uint8, red green blue, as a JPEG in a data URI."""
    _, jpeg = cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode("ascii")


def _data(sheet: ContactSheet) -> dict[str, Any]:
    start_s = float(sheet.borders_s[0])
    return {
        "name": sheet.name,
        "file": f"{_plain(sheet.name)}-labels.csv",
        "pictures": [jpeg_uri(picture) for picture in sheet.pictures],
        "seconds": [round(float(stamp_s) - start_s, 3) for stamp_s in sheet.stamps_s],
        # As text, since what a browser makes of a number may lack digits that stamps need.
        "borders": [f"{stamp_s:.6f}" for stamp_s in sheet.borders_s],
        "labels": sheet.labels.tolist(),
        "names": list(sheet.names),
        "colours": list(AREA_COLOURS),
        "polygons": [] if sheet.areas is None else [np.round(a.polygon, 3).tolist() for a in sheet.areas],
        "places": [_place(xy) for xy in sheet.xy_m.tolist()],
    }


def _place(xy_m: Sequence[float]) -> list[float] | None:
    return [round(value, 3) for value in xy_m] if np.isfinite(xy_m).all() else None


def _plain(name: str) -> str:
    return "".join(sign if sign.isalnum() or sign in "-_." else "_" for sign in name) or "recording"


def _asset(name: str) -> str:
    return (resources.files("wheelsight.report") / name).read_text(encoding="utf-8")
