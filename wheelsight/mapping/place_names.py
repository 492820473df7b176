"""What places and areas of a map may be called, and what is said of a name that none has."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from difflib import get_close_matches
from typing import Any

from wheelsight.errors import MapError

LONGEST_NAME = 60
# For a space and a number behind a name.
_ROOM = 6
# In one line; wheelsight map name MAP --list shows all.
_MOST_SHOWN = 50


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


def free_names(names: Iterable[str | None], taken: Iterable[str]) -> Iterator[str | None]:
    """Each name, or where it is taken, also by one before it, with a number behind it that is free, from 2 on."""
    used, next_number = set(taken), dict[str, int]()
    for name in names:
        found, begin = name, "" if name is None else name[: LONGEST_NAME - _ROOM]
        number = next_number.get(begin, 2)  # a search from 2 on for each would take the square of their number
        while found in used:
            found, number = f"{begin} {number}", number + 1
        next_number[begin] = number
        if found is not None:
            used.add(found)
        yield found


def name_given_twice(names: Iterable[str]) -> str | None:
    """The first of some names that is there more than once."""
    return next((name for name, count in Counter(names).items() if count > 1), None)


def unknown_name(name: str, known: Collection[str]) -> MapError:
    """What to raise for a name that none of the known ones is; tells the nearest of them, and all."""
    lower = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), lower, n=1)
    meant = f" (did you mean {lower[near[0]]}?)" if near else ""
    fix = "the map has no names yet: wheelsight map name MAP NAME --at X,Y,YAW_DEG"
    if known:
        shown, more = sorted(known)[:_MOST_SHOWN], len(known) - _MOST_SHOWN
        fix = f"known: {', '.join(shown)}" + (f" and {more:,} more" if more > 0 else "")
    return MapError(f"no place of the map is called {name!r}{meant}", fix=fix)
