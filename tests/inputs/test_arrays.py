from __future__ import annotations

import io
import tracemalloc
import zipfile
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from wheelsight.core.inputs import ArrayFile

MEGABYTE = 1 << 20


def packed(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def with_header(content: bytes, shape: tuple[int, ...], descr: Any = "<f8", is_fortran: bool = False) -> bytes:
    """A file of one array with a header of its own."""
    buffer, file = io.BytesIO(), io.BytesIO()
    reported = {"descr": descr, "fortran_order": is_fortran, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, reported)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", buffer.getvalue() + content)
    return file.getvalue()


def named(name: bytes, content: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name.decode(), content)
    return file.getvalue()


def test_arrays_come_back(rng: np.random.Generator) -> None:
    arrays: dict[str, np.ndarray] = {
        "a": rng.normal(size=(3, 4)),
        "b": np.arange(5, dtype=np.uint8),
        "c": np.zeros((0, 4), np.uint64),
    }
    file = ArrayFile(packed(**arrays))
    assert {name: (header.shape, header.dtype) for name, header in file.headers.items()} == {
        name: (array.shape, array.dtype) for name, array in arrays.items()
    }
    for name, array in arrays.items():
        assert_array_equal(file.read(name, array.nbytes), array, strict=True)
    file.read("b", 5)[0] = 9  # may be written to
    with pytest.raises(KeyError):
        file.read("d", 1)


def test_what_is_larger_than_allowed_is_not_unpacked() -> None:
    data = packed(a=np.zeros(4 * MEGABYTE, np.uint8))
    tracemalloc.start()
    with pytest.raises(ValueError, match=f"states {4 * MEGABYTE:,} bytes of a, more than the 1,000 allowed"):
        ArrayFile(data).read("a", 1000)
    assert tracemalloc.get_traced_memory()[1] < MEGABYTE // 2
    tracemalloc.stop()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"no archive",
        with_header(bytes(16), (3,)),
        with_header(bytes(4 * MEGABYTE), (2,)),
        with_header(bytes(8), (1 << 61,)),
        with_header(bytes(8), (-1,)),
        with_header(bytes(8), (1,), "|O"),
        with_header(bytes(8), (1,), [("x", "<f8")]),
        with_header(bytes(8), (1,), "<U2"),
        with_header(b"", (5,), "|S0"),
        with_header(bytes(48), (2, 3), is_fortran=True),
        with_header(bytes(8), (1,) * 20),
        with_header(bytes(8), (1,), "<f3"),
        named(b"a.npy", b"\x93NUMPY\x01\x00\x10\x00{'denc\xaa: ((((\n    " + bytes(8)),
        named(b"a.npy", b"\x93NUMPY\x09\x00\x10\x00" + bytes(24)),
        named(b"a.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(24)),
        named(b"a.npy", b"\x93NUM"),
        packed(**{f"a{number}": np.zeros(1) for number in range(70)}),
        packed(a=np.arange(1000.0))[:-300],
    ],
)
def test_what_is_no_file_of_plain_arrays_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"^(is no|holds) "):
        ArrayFile(data)


def test_damage_within_an_array_is_refused(rng: np.random.Generator) -> None:
    array = rng.normal(size=1000)
    data = bytearray(packed(a=array))
    data[len(data) // 2] ^= 1
    with pytest.raises(ValueError, match=r"holds a, (which is damaged|an array that)"):
        ArrayFile(bytes(data)).read("a", array.nbytes)


def test_each_name_stands_once_and_is_packed_in_a_known_way() -> None:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(1))
    for ways in ((zipfile.ZIP_STORED, zipfile.ZIP_STORED), (zipfile.ZIP_BZIP2,), (zipfile.ZIP_LZMA,)):
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w") as archive:
            for number, way in enumerate(ways):
                archive.writestr("a.npy" if number else "a", buffer.getvalue(), compress_type=way)
        with pytest.raises(ValueError, match="in a way that is not read"):
            ArrayFile(file.getvalue())
