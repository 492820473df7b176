"""Pages that several benchmarks write to, a section each: one that is measured again takes its own one's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.table import Sheet
from wheelsight.core.files import write_text


def write_section(path: Path, title: str, reported: str, about: Mapping[str, str], sheets: Sequence[Sheet]) -> None:
    """Put a section into a page: what it measures, what it ran on, and its tables; the others stay as they are."""
    lines = "\n".join(f"- {topic}: {value}" for topic, value in about.items())
    # The page's headings are one level deeper than a table's own would be.
    tables = "\n".join(sheet.to_markdown().replace("## ", "### ", 1) for sheet in sheets)
    sections = sections_of(path.read_text(encoding="utf-8") if path.exists() else "")
    sections[title] = f"## {title}\n\n{reported.strip()}\n\n{lines}\n\n{tables}"
    head = sections.pop("", "# Navigation\n")
    write_text(path, "\n".join([head, *(section.rstrip("\n") + "\n" for section in sections.values())]))


def sections_of(page: str) -> dict[str, str]:
    """By their titles, in order; what is before the first has none."""
    found: dict[str, list[str]] = {}
    title = ""
    for line in page.splitlines():
        if line.startswith("## "):
            title = line.removeprefix("## ")
        found.setdefault(title, []).append(line)
    return {title: "\n".join(lines) for title, lines in found.items()}
