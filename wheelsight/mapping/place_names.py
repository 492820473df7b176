"""What places and areas of a map may be called, and what is said of a name that none has."""

from __future__ import annotations

from collections.abc import Collection
from difflib import get_close_matches
from typing import Any

from wheelsight.errors import MapError

LONGEST_NAME = 60


def checked_name(name: Any) -> str:
    """A name, with one space between its words.

    It has up to 60 letters, digits, spaces and signs, but no commas, by which coordinates are told.

    Raises:
        MapError: it is none.
    """
    text = " ".join(name.split()) if isinstance(name, str) else ""
    if not text or "," in text or len(text) > LONGEST_NAME or not text.isprintable() or text.startswith("-"):
        problem = f"{name!r} is no name for a place"
        raise MapError(problem, fix=f"up to {LONGEST_NAME} letters, digits and spaces, without commas")
    return text


def free_name(name: str, taken: Collection[str]) -> str:
    """A name, or where it is taken the same with the first number behind it that is free, from 2 on."""
    found, number = name, 2
    while found in taken:
        found, number = f"{name[: LONGEST_NAME - 4]} {number}", number + 1
    return found


def unknown_name(name: str, known: Collection[str]) -> MapError:
    """What to raise for a name that none of the known ones is; tells the nearest of them, and all."""
    lower = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), lower, n=1)
    meant = f" (did you mean {lower[near[0]]}?)" if near else ""
    fix = "the map has no names yet: wheelsight map name MAP NAME --at X,Y,YAW_DEG"
    if known:
        fix = f"known: {', '.join(sorted(known))}"
    return MapError(f"no place of the map is called {name!r}{meant}", fix=fix)
