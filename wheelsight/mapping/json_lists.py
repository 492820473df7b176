"""What people said of a map, as JSON beside it: a format, its version, and a list."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wheelsight.errors import MapError
from wheelsight.inputs import Kind, parse_json, read_text


def read_list(path: Path, kind: Kind, written: tuple[str, int], field: str) -> list[Any]:
    """The list of a file.

    Args:
        path: of the file.
        kind: of it, for messages.
        written: its format, and the newest version that is read.
        field: name of the list.

    Raises:
        MapError: it is missing, of another format, newer, or has no list.
    """
    name, newest = written
    try:
        document = parse_json(read_text(path, kind, MapError))
    except ValueError as error:
        raise MapError(f"is no JSON: {error}", path=path, fix=kind.fix) from error
    if not isinstance(document, dict) or document.get("format") != name:
        raise MapError(f"is not of format {name!r}", path=path, fix=kind.fix)
    version = document.get("version")
    if type(version) is not int or not 1 <= version <= newest:
        problem = f"its version is {version!r}, and this wheelsight reads {newest}"
        raise MapError(problem, path=path, fix="open it with the wheelsight that wrote it, or a newer one")
    listed = document.get(field)
    if not isinstance(listed, list):
        raise MapError(f"its {field} are no list", path=path, fix=kind.fix)
    return listed
