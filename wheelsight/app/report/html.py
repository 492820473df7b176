"""The HTML elements of the pages. All text is escaped here, and only here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources

from wheelsight.app.report import plotly as go
from wheelsight.app.report.pictures import lean_json
from wheelsight.app.run.verdict import Finding, Tone

# As `section` writes it.
_HEADING = re.compile('<h2 id="([^"]+)">([^<]*)</h2>')
_FEWEST_LINKED = 3
# Words beside the colours, for readers who do not see these apart.
_TONES = {Tone.GREEN: "Good:", Tone.AMBER: "Care:", Tone.RED: "Bad:"}


def asset(name: str) -> str:
    """The text of a template, style or script that lies beside the pages."""
    return (resources.files("wheelsight.app.report") / name).read_text(encoding="utf-8")


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
