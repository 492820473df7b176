"""The form of all pages, and their HTML elements. All text is escaped here, and only here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from wheelsight import __version__
from wheelsight.app.run.verdict import Finding, Tone
from wheelsight.core.files import StrPath, write_text
from wheelsight_report import plotly as go
from wheelsight_report.pictures import lean_json, packed

# As `section` writes it.
_HEADING = re.compile('<h2 id="([^"]+)">([^<]*)</h2>')
_FEWEST_LINKED = 3
# Words beside the colours, for readers who do not see these apart.
_TONES = {Tone.GREEN: "Good:", Tone.AMBER: "Care:", Tone.RED: "Bad:"}


def page(
    *,
    kicker: str,
    title: str,
    facts: Iterable[str],
    tone: str,
    phrase: str,
    sentences: Iterable[str],
    tiles: Iterable[tuple[str, str, str]],
    sections: Iterable[str],
    footer: str,
    notes: Sequence[str] = (),
    no_notes: str = "",
    found: Iterable[Finding] = (),
    more: str = "",
) -> str:
    """A self-contained page that opens offline. `sections` and `more` are HTML, all else is text.

    Args:
        kicker, title, facts: head of the page.
        tone, phrase, found, sentences, more: verdict, in this order.
        tiles: name, value and relative value of each key figure.
        sections: below the key figures; empty ones are left out.
        footer: conventions of the page.
        notes: what to know before trusting it. Without notes the section has the sentence `no_notes`, or is left out.
    """
    body = "\n".join(filter(None, sections))
    remarks = bullets(notes, "notes") if notes else ""
    noted = section("notes", "What to know before trusting it", "" if notes else no_notes, remarks)
    noted = noted if notes or no_notes else ""
    return Template(asset("template.html")).substitute(
        kicker=kicker,
        title=escape(title),
        facts=" · ".join(map(escape, facts)),
        tone=tone,
        phrase=escape(phrase),
        findings=findings(found),
        sentences=lines(sentences),
        more=more,
        tiles="\n".join(tile(*one) for one in tiles),
        contents=contents(noted + body),
        notes=noted,
        sections=body,
        footer=escape(footer),
        style=asset("style.css"),
        plotly=packed(asset("plotly-cartesian.min.js").encode()),
        script=asset("page.js") + (asset("cloud.js") if 'class="cloud"' in body else ""),
    )


def facts_now(*facts: str) -> list[str]:
    """Facts of a page about results that are not stored: with the time of this call, and the version."""
    return [*facts, datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), f"wheelsight {__version__}"]


def save(page: str, path: StrPath) -> None:
    """Write a page to `path`, atomically. Raises OutputError."""
    # A folder's name may hold bytes that are no text; they must not cost the page.
    write_text(Path(path), page.encode("utf-8", "replace").decode("utf-8"))


def asset(name: str) -> str:
    """The text of a template, style or script that lies beside the pages."""
    return (resources.files("wheelsight_report") / name).read_text(encoding="utf-8")


def section(key: str, title: str, intro: str, *parts: str) -> str:
    """A section with its heading and a sentence; `parts` are HTML."""
    body = "\n".join(part for part in parts if part)
    heading = f'<h2 id="{key}">{escape(title)}</h2>'
    return f'<section aria-labelledby="{key}">\n{heading}\n{paragraph(intro)}{body}\n</section>'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph, or nothing for no text."""
    return f"<p{_class(kind)}>{escape(text)}</p>\n" if text else ""


def plot(key: str, figure: go.Figure, title: str, sentence: str, alt: str) -> str:
    """A plotly figure as data that the page's script draws, with its caption; `alt` says what it shows."""
    data = lean_json(figure.to_json()).replace("<", "\\u003c")
    height = figure.layout.height
    return (
        f"<figure>\n<figcaption><strong>{escape(title)}.</strong> {escape(sentence)}</figcaption>\n"
        f'<div class="plot" id="plot-{key}" style="min-height:{height}px" role="img" aria-label="{escape(alt)}"></div>'
        f'<script type="application/json">{data}</script>\n</figure>'
    )


def picture(uri: str, caption: str, alt: str) -> str:
    """An image held in the page itself."""
    image = f'<img class="matches" src="{escape(uri)}" alt="{escape(alt)}">'
    return f"<figure>\n{image}\n<figcaption>{escape(caption)}</figcaption>\n</figure>"


def group(kind: str, parts: Iterable[str]) -> str:
    """Parts of HTML side by side where there is room."""
    return f"<div{_class(kind)}>\n" + "\n".join(parts) + "\n</div>"


def tile(name: str, value: str, more: str = "") -> str:
    """A key figure with its name and what puts it into proportion."""
    extra = f'<dd class="more">{escape(more)}</dd>' if more else ""
    return f'<div><dt>{escape(name)}</dt><dd class="value">{escape(value)}</dd>{extra}</div>'


def bullets(items: Sequence[str], kind: str) -> str:
    """A list of sentences."""
    return f"<ul{_class(kind)}>\n" + "\n".join(f"<li>{escape(item)}</li>" for item in items) + "\n</ul>"


def table(caption: str, head: Sequence[str], rows: Sequence[Sequence[str]], main: str | None = None) -> str:
    """A table whose first column names its rows. The row named `main` stands out; wide tables scroll."""
    heads = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    lines = "\n".join(
        f'<tr{_class("main" if name == main else "")}><th scope="row">{escape(name)}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for name, *cells in rows
    )
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table>\n'
        f"<caption>{escape(caption)}</caption>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n{lines}\n</tbody>\n</table></div>"
    )


def lines(sentences: Iterable[str]) -> str:
    """One short sentence a line."""
    return "<br>\n".join(escape(sentence) for sentence in sentences)


def findings(found: Iterable[Finding]) -> str:
    """Findings of a verdict, one a line: how bad in a word, the sentence, and what to do."""
    items = "\n".join(
        f'<li class="{one.tone}"><b>{_TONES[one.tone]}</b> {escape(one.sentence)}'
        + (f" <b>To do:</b> {escape(one.remedy)}." if one.remedy else "")
        + "</li>"
        for one in found
    )
    return f'<ul class="findings">\n{items}\n</ul>\n' if items else ""


def folded(title: str, text: str) -> str:
    """Preformatted text, folded away until asked for."""
    return fold(title, f"<pre>{escape(text)}</pre>")


def fold(title: str, part: str) -> str:
    """A part of HTML, folded away until asked for."""
    return f"<details>\n<summary>{escape(title)}</summary>\n{part}\n</details>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def contents(sections: str) -> str:
    """Links to sections of HTML by their headings; nothing where there are hardly any."""
    found = _HEADING.findall(sections)
    if len(found) < _FEWEST_LINKED:
        return ""
    links = "\n".join(f'<li><a href="#{key}">{title}</a></li>' for key, title in found)
    return f'<nav aria-label="Contents">\n<ul>\n{links}\n</ul>\n</nav>'
