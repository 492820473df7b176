"""Models of places in files: plain values and arrays in skops' format, and nothing that could do something."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from wheelsight.errors import PlaceError
from wheelsight.extras import needed
from wheelsight.files import StrPath, write_bytes
from wheelsight.inputs import Kind, parse_json, read_bytes

Made = TypeVar("Made")
# A forest of 64 trees takes some megabytes, and 20 unpacked; one of 1000, on ten times as many frames, 400.
_MOST_BYTES = 1 << 28
_MOST_SCHEMA_BYTES = 1 << 20
_MOST_ENTRIES = 1000
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # the others are unpacked whole, whatever size they name
_NUMBERS = "biuf"
RETRAIN = "train the model again"
NO_MODEL = "give a file that `PlaceModel.save` wrote"
_DISTRUST = "do not trust this file"
_FILE = Kind("a model of places", most_mb=256, fix=NO_MODEL)
# What a model of ours is made of; skops itself would allow far more, such as estimators and functions of numpy.
_PLAIN = {
    ("DictNode", "builtins.dict"),
    ("ListNode", "builtins.list"),
    ("JsonNode", "builtins.str"),
    ("TypeNode", "builtins.str"),
    ("NdArrayNode", "numpy.ndarray"),
}


def save_document(document: dict[str, Any], path: StrPath) -> None:
    """Write plain values and arrays atomically. Raises OutputError."""
    write_bytes(path, needed("skops.io").dumps(document, compression=zipfile.ZIP_DEFLATED))


def load_document(path: StrPath, made_into: Callable[[Any], Made]) -> Made:
    """Read plain values and arrays, and make a model of them by `made_into`, whose errors become this file's.

    Raises:
        PlaceError: naming the file: it cannot be read, is no model, holds more than plain values and arrays (nothing
            of it is then made), is of another version, or contradicts itself.
        ConfigError: skops is not installed.
    """
    path, skops_io = Path(path), needed("skops.io")
    data = read_bytes(path, _FILE, PlaceError)
    try:
        _refuse_all_but_plain(data)
        return made_into(skops_io.loads(data, trusted=[]))
    except PlaceError as error:
        raise PlaceError(error.problem, path=path, fix=error.fix) from error
    except Exception as error:  # a damaged file fails inside zip, json, numpy or skops in ways of their own
        raise PlaceError(f"is damaged: {type(error).__name__}", path=path, fix=RETRAIN) from error


def _refuse_all_but_plain(data: bytes) -> None:
    """Read the file's table of contents, and only that; whatever it names but plain values is refused."""
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise PlaceError("is no model of places", fix=NO_MODEL)
    if data.count(b"PK\x01\x02") > _MOST_ENTRIES:
        raise PlaceError("lists more than a model of places ever holds", fix=_DISTRUST)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        if "schema.json" not in archive.namelist():
            raise PlaceError("is no model of places", fix=NO_MODEL)
        if any(entry.compress_type not in _PACKED for entry in archive.infolist()):
            raise PlaceError("is packed in a way that models of places are not", fix=_DISTRUST)
        sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
        if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
            raise PlaceError("unpacks to more than a model of places ever needs", fix=_DISTRUST)
        if sizes["schema.json"] > _MOST_SCHEMA_BYTES:
            raise PlaceError("lists more than a model of places ever holds", fix=_DISTRUST)
        try:
            schema = parse_json(archive.read("schema.json"))
        except ValueError as error:
            raise PlaceError(f"its list of contents {error}", fix=_DISTRUST) from error
        odd = {found for found in _types_in(schema) if found not in _PLAIN}
        if odd:
            loader, kind = sorted(odd)[0]
            raise PlaceError(f"holds a {kind} ({loader}), which no model of places does", fix=_DISTRUST)
        _refuse_large_arrays(archive, schema, sizes)
    untrusted = needed("skops.io").get_untrusted_types(data=data)
    if untrusted:
        raise PlaceError(f"holds a {untrusted[0]}, which no model of places does", fix=_DISTRUST)


def _refuse_large_arrays(archive: zipfile.ZipFile, schema: Any, sizes: dict[str, int]) -> None:
    """Read the arrays' headers, and only these: they must be of numbers, and as large as they say."""
    named = [str(node["file"]) for node in _nodes_in(schema) if "file" in node]
    if sum(sizes.get(name, 0) for name in named) > _MOST_BYTES:  # one may be named many times over
        raise PlaceError("unpacks to more than a model of places ever needs", fix=_DISTRUST)
    for name in set(named):
        with archive.open(name) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, kind = read(stream)
            told = stream.tell() + math.prod(shape) * kind.itemsize
        if kind.kind not in _NUMBERS or not kind.itemsize or min(shape, default=0) < 0 or told != sizes[name]:
            raise PlaceError(f"holds {name}, an array that is not what it says", fix=_DISTRUST)


def _nodes_in(schema: Any) -> Iterator[dict[str, Any]]:
    """Everything that a skops schema would make, at any depth."""
    waiting = [schema]
    while waiting:
        node = waiting.pop()
        if isinstance(node, dict):
            yield node
            waiting.extend(node.values())
        elif isinstance(node, list):
            waiting.extend(node)


def _types_in(schema: Any) -> Iterator[tuple[str, str]]:
    """Loader and full type of everything that a skops schema would make."""
    for node in _nodes_in(schema):
        if "__loader__" in node or "__class__" in node:
            yield str(node.get("__loader__")), f"{node.get('__module__')}.{node.get('__class__')}"
