"""Private vocabulary in docstrings, comments, messages and pages: ceilings by word that are lowered, and never rise.

`python tests/test_words.py` lowers `tests/private_words.txt` to today's counts and names the places of the rest.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from sources import PACKAGES

PROJECT = Path(__file__).resolve().parent.parent
CEILINGS = Path(__file__).with_name("private_words.txt")
# What a reader of numpy, GTSAM or Nav2 does not expect, and what to write instead.
WORDS = {
    "told": (r"t(?:old|ells?|elling)", "say, report, show, state, estimate, distinguish"),
    "nobody": (r"nobody", "no person, nothing, or the active voice without it"),
    "whoever": (r"whoever", "a caller that, a user who"),
    "whom": (r"whom", "a shorter sentence"),
    "anew": (r"anew", "again"),
    "reckon": (r"reckon(?:s|ed|ing)?", "compute, estimate"),
    "mend": (r"mend(?:s|ed|ing)?", "correct, repair, fix"),
    "hear": (r"hear(?:s|d|ing)?", "receive, process, read"),
    "let go": (r"lets? go|letting go", "release, drop, forget"),
    "so many": (r"so many", "the number"),
    "of which, by which": (r"(?:of|by) which", "two sentences"),
    "what is … is": (r"what (?:is|are|was|were) [^.,;:!?()]{1,60}? (?:is|are|was|were)", "the noun"),
    "of before": (r"of before", "earlier, older, existing"),
    "there where": (r"there where", "where"),
    "thereby": (r"thereby|thereof|henceforth|hence", "so, from now on, or two sentences"),
    "heed": (r"heed(?:s|ed|ing)?", "consider, use, obey"),
    "astray": (r"astray", "wrong, misled, diverged"),
    "in vain": (r"in vain", "without success"),
    "for want of": (r"for want of", "without"),
    "who does": (r"(?:^|(?<=[.;:] )|(?<=\| ))who [a-z]+", "the noun: a robot that, a user who"),
    "comes of": (r"c(?:omes?|ame) of", "results from"),
    "foretell": (r"fore(?:tells?|told)", "predict"),
    "what stands": (r"what (?:stands?|stood|lies|lay|comes?|came|goes)", "the noun: an obstacle, a reading"),
    "leap": (r"leap(?:s|t|ed|ing)?", "jump"),
    "believe": (r"believ(?:es?|ed|ing)", "accept, trust, estimate"),
    "somebody": (r"some(?:body|one)", "a person, a user"),
    "goes by": (r"(?:go|goes|going|gone|went) by", "use, follow, pass"),
    "by now": (r"by now", "now, latest, current"),
    "so long": (r"so long", "this time, the time"),
    "hang on": (r"h(?:angs?|ung) on", "belong to, be attached to"),
    "laid on": (r"la(?:id|ys?) (?:up)?(?:on|over|under|against)", "aligned with, combined with"),
    "as ever": (r"as ever|lest", "as before, so that … not"),
    "title": (r"^#+ (?:what|how|who|whom|whose|where|when|why|if|that) [^\n]*", "a noun"),
}
ANY = re.compile(
    rf"(?<![\w-])(?:{'|'.join(f'({pattern})' for pattern, _ in WORDS.values())})(?![\w-])", re.IGNORECASE | re.MULTILINE
)
# Terms that contain such a word, and why they stay.
TERMS = ("dead reckoning",)  # the field's name of integrated odometry
# Pages whose text is counted where it is written.
MADE = (PROJECT / "docs" / "configuration.md",)  # of the settings' texts in the code


class Place(NamedTuple):
    file: Path
    line: int


STRING_OR_COMMENT = re.compile(r'"""(?:[^\\]|\\.)*?"""|"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\'|#[^\n]*', re.DOTALL)


def of_source(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each comment and of each string of several words."""
    line, at = 1, 0
    for found in STRING_OR_COMMENT.finditer(source):
        line, at = line + source.count("\n", at, found.start()), found.start()
        if " " in found[0]:
            yield line, found[0].lstrip("# ")


def of_page(page: str) -> Iterator[tuple[int, str]]:
    """Line and text of each paragraph; blocks of code and output are left out."""
    prose = re.sub(r"^ *```.*?^ *```", lambda block: "\n" * block[0].count("\n"), page, flags=re.MULTILINE | re.DOTALL)
    prose = re.sub(r'"[A-Z][^"|]{25,200}"', lambda quoted: "\n" * quoted[0].count("\n"), prose)  # messages of commits
    for found in re.finditer(r"(?:^.*\S.*\n?)+", prose, re.MULTILINE):
        yield prose[: found.start()].count("\n") + 1, found[0]


def plain(text: str) -> str:
    """Without names in backticks, targets of links and terms; lines joined."""
    text = re.sub(r"`[^`\n]*`|\]\([^)]*\)", "` ", text)
    text = re.sub("|".join(TERMS), "", text, flags=re.IGNORECASE)
    return re.sub(r"\s+(?:# )?", " ", text)


def found_in(text: str) -> Counter[str]:
    words = list(WORDS)
    return Counter(words[found.lastindex - 1] for found in ANY.finditer(plain(text)) if found.lastindex)


@cache
def places() -> dict[str, dict[str, list[Place]]]:
    """The places of each word, in code and on pages."""
    sources = [file for folder in PACKAGES for file in sorted((PROJECT / folder).rglob("*.py"))]
    pages = [PROJECT / "README.md", *(file for file in sorted((PROJECT / "docs").rglob("*.md")) if file not in MADE)]
    found: dict[str, dict[str, list[Place]]] = {word: {"code": [], "pages": []} for word in WORDS}
    for file in (*sources, *pages):
        kind, parts = ("code", of_source) if file.suffix == ".py" else ("pages", of_page)
        for line, text in parts(file.read_text(encoding="utf-8")):
            for word, count in found_in(text).items():
                found[word][kind] += count * [Place(file.relative_to(PROJECT), line)]
    return found


def ceilings() -> dict[str, dict[str, int]]:
    rows = [line.rsplit(maxsplit=2) for line in CEILINGS.read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    return {word: {"code": int(code), "pages": int(pages)} for word, code, pages in rows}


@pytest.mark.parametrize("word", WORDS)
def test_private_words_become_fewer(word: str) -> None:
    for kind, found in places()[word].items():
        allowed = ceilings()[word][kind]
        where = " ".join(f"{place.file}:{place.line}" for place in found[:9])
        assert len(found) <= allowed, f"{word}: {len(found)} in {kind}, not {allowed}; write {WORDS[word][1]}: {where}"
        assert len(found) >= 0.5 * allowed - 3, f"{word}: {len(found)} in {kind}: run this file to lower {allowed}"


def test_words_are_found_as_a_whole_and_not_in_names() -> None:
    source = '"""It told nobody\n# so."""\nx = "told"  # a reader who is told\n_ = f"by which {x} is heard"\nanew = 1\n'
    counts = [found_in(text) for _, text in of_source(source)]
    assert [sum(part["told"] for part in counts), sum(part["nobody"] for part in counts)] == [2, 1]
    assert sum(part["hear"] + part["of which, by which"] for part in counts) == 2
    assert sum(part["anew"] for part in counts) == 0
    page = "A `told` and\ndead reckoning. Who\nstands?\n\n```console\ntold\n```\nWhat is near is [slow](told.md).\n"
    counts = [found_in(text) for _, text in of_page(page)]
    assert [sum(part[word] for part in counts) for word in ("told", "reckon")] == [0, 0]
    assert [sum(part[word] for part in counts) for word in ("who does", "what is … is")] == [1, 1]
    assert [line for line, _ in of_page(page)] == [1, 8]
    titles = ("# What it is\n", "## The whole\n", "## When a part fails\n")
    assert [found_in(title)["title"] for title in titles] == [1, 0, 1]


def lower() -> None:
    """Write the ceilings that fell. A word without a ceiling gets today's count."""
    old = ceilings() if CEILINGS.exists() else {}
    rows = ["# Most occurrences that tests/test_words.py allows: word, in code, on pages. They only fall."]
    for word, by_kind in places().items():
        counts = [min(len(found), old.get(word, {}).get(kind, len(found))) for kind, found in by_kind.items()]
        rows.append(f"{word} {counts[0]} {counts[1]}")
        for place in (*by_kind["code"], *by_kind["pages"]):
            sys.stdout.write(f"{place.file}:{place.line}: {word}\n")
    CEILINGS.write_text("\n".join([*rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    lower()
