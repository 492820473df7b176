"""Changes to sound files by random numbers: of bytes, text, YAML, JSON, images, archives, and which files there are."""

from __future__ import annotations

import io
import json
import lzma
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import fuzz_records

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]
_WORDS = (
    *(
        "nan",
        "inf",
        "-inf",
        "1e400",
        "1e100",
        "-1e100",
        "1e15",
        "9" * 5000,
        "9" * 30,
        "18446744073709551616",
        "-0",
        "0",
    ),
    *(
        "1_0",
        "0x10",
        "1,5",
        "1.5e",
        "+",
        "-",
        "",
        "\0",
        "\ufeff",
        '"',
        "'",
        '"a b"',
        ";",
        ",",
        "#",
        "# x",
        "\\",
        "..",
        "/",
    ),
    *(
        "/dev/zero",
        "/dev/stdin",
        "/proc/self/mem",
        "../../..",
        "[/]",
        "[bold]",
        "\x1b[31m",
        "é",
        "１２",
        "\u2028",
        "a" * 5000,
    ),
    *("true", "null", "~", "2024-05-02", "2024-13-45", "1:2:3", "1e-300", "4294967296", "-1", "timestamp", "stamp_s"),
)
_NODES = (
    *("!!int ''", "!!float x", "!!bool x", "!!null x", "!!timestamp x", "!!binary x", "!!set {a, b}", "!!python/none"),
    *(
        "&a [*a]",
        "*a",
        "&a x",
        "{<<: *a}",
        "<<: x",
        "[" * 600 + "]" * 600,
        "{a: " * 200 + "}" * 200,
        "[[], {}]",
        "? [a]",
    ),
    *(
        "2024-05-02",
        "2024-13-45",
        "9" * 6000,
        "0b" + "1" * 9000,
        "1" + ":59" * 2000,
        ".inf",
        ".nan",
        "1e400",
        "1e100",
        "@",
    ),
    *(
        "|\n  text",
        '"\\0"',
        '"\\ud800"',
        "[1, 2",
        "'",
        "{}",
        "[]",
        "~",
        "- -",
        "%YAML 1.1",
        "---",
        "...",
        "-1",
        "1e-320",
    ),
    *("[1, 2, 3, 4]", "[[1]]", "[a, b]", "{a: 1}", "true", "''", "1.5", "[nan]", "[1e400]", "16", "4096", "99999"),
)
_LAUGHS = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{now}: &{now} [{','.join([f'*{last}'] * 9)}]\n" for last, now in zip("abcdefgh", "bcdefghi", strict=True)
)
_INTEGER = b"\x00\x00\xff\xff\x7f\x80\x01"
_LARGE = 30_000
_MOST_BYTES, _MOST_UNPACKED = 8_000_000, 1 << 27
# A larger file is read as long as any recording of its size: 50 000 copies of a frame make 1.7 GB.
_LARGEST_BYTES = 1 << 28


def damaged(name: str, data: bytes, rng: Rng) -> bytes:
    """A file's bytes after one to three changes that suit its kind."""
    for _ in range(int(rng.integers(1, 4))):
        if len(data) > _MOST_BYTES:  # further changes would take longer to make than to read
            break
        changed = _pick(_changes_of(name, data), rng)(data, rng)
        data = changed if len(changed) <= _LARGEST_BYTES else data
    return data


def replace_with_no_file(path: Path, rng: Rng) -> None:
    """Something else in a file's place: a pipe, a folder, a link, or ten gigabytes that take no room on the disk."""
    import os

    path.unlink()
    what = int(rng.integers(8))
    if what == 0:
        os.mkfifo(path)
    elif what == 1:
        path.mkdir()
    elif what == 2:
        with path.open("wb") as stream:
            stream.truncate(10 << 30)
    elif what == 7:
        path.write_bytes(b"")
    else:
        path.symlink_to(("/dev/zero", "/proc/self/mem", path.name, "nowhere")[what - 3])


def changed_files(files: Mapping[str, bytes], rng: Rng) -> dict[str, bytes]:
    """The files with one of them gone, under another name, in another's place, there twice, or beside a strange one."""
    changed = dict(files)
    name, other = (str(found) for found in rng.choice(sorted(files), 2))
    what = int(rng.integers(5))
    if what == 0:
        del changed[name]
    elif what == 1:
        changed[name], changed[other] = files[other], files[name]
    elif what == 2:
        changed[other] = files[name]
    else:
        folder, _, last = name.rpartition("/")
        stem, dot, suffix = last.rpartition(".")
        digits = re.sub(r"[0-9](?=[^0-9]*$)", "\u00b2", stem)
        number = re.sub(r"[0-9]+(?=[^0-9]*$)", "9" * 30, stem)
        names = (digits, number, stem + "\n", stem + "\udcff", "-" + stem, "." + stem, "9" + stem, stem.upper())
        called = f"{_pick(names, rng)}{dot}{suffix}"
        data = changed.pop(name) if what == 3 else files[name]
        changed[f"{folder}/{called}" if folder else called] = data
    return changed


def _changes_of(name: str, data: bytes) -> tuple[Callable[[bytes, Rng], bytes], ...]:
    suffix = name.rpartition(".")[2]
    if suffix in ("png", "jpg", "bmp", "tif", "pgm"):
        return (*_BYTES, _large_image, _header_of_another)
    if data.startswith(b"PK"):
        return (*_BYTES, *_ARCHIVE * 3)
    if suffix == "surfels":
        return (*_BYTES, *_MAP * 3)
    if suffix in _OF_RECORDS:
        return (*_BYTES, *(_of_records(_OF_RECORDS[suffix]),) * (2 * len(_BYTES)))
    if suffix == "yaml":
        return (*_BYTES, *_TEXT, *_YAML * 4)
    if suffix == "json":
        return (*_BYTES, *_TEXT, *(_json, _many) * 6)
    return (*_BYTES, *_TEXT * 4)


def _of_records(change: Callable[[bytes, Rng, Change], bytes]) -> Change:
    def changed(data: bytes, rng: Rng) -> bytes:
        try:
            return change(data, rng, _pick(_BYTES, rng))
        except Exception:  # an earlier change has damaged it
            return data

    return changed


def _pick(choices: tuple[Any, ...], rng: Rng) -> Any:
    return choices[int(rng.integers(len(choices)))]


def _span(data: bytes, rng: Rng) -> tuple[int, int]:
    begin = int(rng.integers(len(data) + 1))
    return begin, min(begin + int(rng.integers(1, 20)), len(data))


def _flip(data: bytes, rng: Rng) -> bytes:
    if not data:
        return b"\xff"
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :]


def _overwrite(data: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + bytes(rng.choice(list(_INTEGER), end - begin).astype(np.uint8)) + data[end:]


def _cut(data: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] if rng.random() < 0.5 else data[:begin] + data[end:]


def _repeat(data: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    times = int(_pick((2, 10, 1000, 50_000), rng))
    return data[:begin] + data[begin:end] * times + data[end:]


def _noise(data: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + rng.bytes(int(rng.integers(1, 40))) + data[end:]


def _text(change: Callable[[str, Rng], str]) -> Callable[[bytes, Rng], bytes]:
    def changed(data: bytes, rng: Rng) -> bytes:
        return change(data.decode("utf-8", "surrogateescape"), rng).encode("utf-8", "surrogatepass")

    return changed


@_text
def _word(text: str, rng: Rng) -> str:
    words = re.split(r"([\s,;]+)", text)
    words[int(rng.integers(len(words)))] = _pick(_WORDS, rng)
    return "".join(words)


@_text
def _lines(text: str, rng: Rng) -> str:
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    what = int(rng.integers(7))
    if what == 0:
        lines.insert(at, lines[int(rng.integers(len(lines)))])
    elif what == 1:
        del lines[at]
    elif what == 2:
        lines = [lines[i] for i in rng.permutation(len(lines))]
    elif what == 3:
        lines[at] = str(
            _pick(("timestamp,filename", "Stamp_S;Left;Right", "# stamp_s,left,right", "t x y z", "\t"), rng)
        )
    elif what == 4:
        lines[at] += str(_pick((" extra", ",,", ";1", " # note", ",0.5,0.5", '"'), rng))
    elif what == 5:
        lines[at] = f"#{lines[at]}"
    else:
        lines += [""] * int(_pick((1, 3, 1000), rng)) + [" "]
    return "\n".join(lines)


@_text
def _many_lines(text: str, rng: Rng) -> str:
    """One line very often; of some, its first number counts on."""
    lines = text.split("\n")
    at = int(rng.integers(len(lines)))
    found = re.search(r"[0-9]+(?=\.|,|\s)", lines[at]) if rng.random() < 0.7 else None
    count = min(int(_pick((100, 20_000, 200_000), rng)), _MOST_BYTES // (len(lines[at]) + 1))
    if found is None:
        lines[at:at] = [lines[at]] * count
    else:
        first, (begin, end), line = int(found[0][:12]), found.span(), lines[at]
        lines[at + 1 : at + 1] = [f"{line[:begin]}{first + i}{line[end:]}" for i in range(1, count)]
    return "\n".join(lines)


@_text
def _dialect(text: str, rng: Rng) -> str:
    what = int(rng.integers(8))
    changes: tuple[Callable[[], str], ...] = (
        lambda: re.sub(r"[ ,]", ";", text),
        lambda: text.replace(".", ","),
        lambda: re.sub(r"[^\s,;]+", r'"\g<0>"', text),
        lambda: text.replace("/", "\\"),
        lambda: re.sub(r"(rgb|depth|color)/", "", text),
        lambda: text.upper(),
        lambda: re.sub(r"[ ,]", "\t", text),
        lambda: text.replace("\n", str(_pick(("\r\n", "\r", "\n\n", "\x0b", "\u2028"), rng))),
    )
    return changes[what]()


def _encoding(data: bytes, rng: Rng) -> bytes:
    text = data.decode("utf-8", "replace")
    return text.encode(str(_pick(("utf-16", "utf-8-sig", "utf-32", "utf-16-be", "cp037"), rng)), "replace")


@_text
def _node(text: str, rng: Rng) -> str:
    spots = [match.span() for match in re.finditer(r"(?<=[:\[,] )[^\s,\]]+", text)] or [(0, 0)]
    begin, end = spots[int(rng.integers(len(spots)))]
    return text[:begin] + str(_pick(_NODES, rng)) + text[end:]


@_text
def _key(text: str, rng: Rng) -> str:
    keys = [match.span() for match in re.finditer(r"\b\w{1,40}(?=:)", text)] or [(0, 0)]
    begin, end = keys[int(rng.integers(len(keys)))]
    return text[:begin] + str(_pick((*_WORDS, "<<", "[a]", "{a: b}", "? x", "- x", "*a"), rng)) + text[end:]


@_text
def _laughing(text: str, rng: Rng) -> str:
    keys = [match.end() for match in re.finditer(r"\b\w{1,40}:", text)] or [0]
    at = keys[int(rng.integers(len(keys)))]
    return _LAUGHS + text[:at] + f" *{_pick(tuple('abcdefghi'), rng)}" + text[at:]


def _large_image(data: bytes, rng: Rng) -> bytes:
    """The size in the header is another; of a PNG, the checksum with it."""
    width, height = (int(_pick((0, 1, 16, _LARGE, 1 << 16, (1 << 31) - 1), rng)) for _ in range(2))
    if not data.startswith(b"\x89PNG"):
        at = data.find(b"\xff\xc0")
        return data[: at + 5] + struct.pack(">HH", height & 0xFFFF, width & 0xFFFF) + data[at + 9 :]
    header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def _header_of_another(data: bytes, rng: Rng) -> bytes:
    """The first bytes of a huge image in another format."""
    size = (_LARGE, _LARGE)
    heads = (
        b"P6 %d %d 255\n" % size,
        b"P5\n# x\n%d %d\n65535\n" % size,
        b"BM" + bytes(16) + struct.pack("<iihh", *size, 1, 24) + bytes(40),
        b"II*\0" + struct.pack("<IHHHIIHHII", 8, 2, 256, 3, 1, _LARGE, 257, 3, 1, _LARGE),
        b"RIFF\xff\xff\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0\x2f\x75\0\x2f\x75\0",
        b"\0\0\0\x0cjP  \r\n\x87\n",
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 30000 +X 30000\n",
        b"GIF89a" + struct.pack("<HH", *size),
        b"\xff\xd8\xff\xe0\0\x04aa\xff\xc2\0\x11\x08"
        + struct.pack(">HH", *size)
        + b"\x03\x01\x11\0\x02\x11\1\x03\x11\1",
    )
    return bytes(_pick(heads, rng)) + (data if rng.random() < 0.5 else bytes(2000))


def _repacked(data: bytes, change: Callable[[dict[str, bytes]], None]) -> bytes:
    """An archive with its files changed; as it is where it can no longer be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(info.file_size for info in archive.infolist()) > _MOST_UNPACKED:  # by an earlier change
                return data
            parts = {name: archive.read(name) for name in archive.namelist()}
        change(parts)
    except Exception:  # an earlier change has damaged it
        return data
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return packed.getvalue()


def _array(data: bytes, rng: Rng) -> bytes:
    """Another header, or other numbers, of one array."""

    def change(parts: dict[str, bytes]) -> None:
        names = [name for name in parts if name.endswith(".npy")]
        name = names[int(rng.integers(len(names)))]
        shape = _pick(("(10000000000,)", "(1 << 40,)", "(-1,)", "()", "(0, 5)", "(3, 3)", "[3]", "(" * 90), rng)
        kind = _pick(("'<f8'", "'|O'", "'|V0'", "'<i4'", "'|S0'", "'<U9'", "[('a', '<f8')]", "'>f4'", "'<M8[s]'"), rng)
        header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
        if rng.random() < 0.5:
            parts[name] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + parts[name][128:]
        else:
            parts[name] = parts[name][:128] + _pick(_BYTES, rng)(parts[name][128:], rng)

    return _repacked(data, change)


def _bomb(data: bytes, rng: Rng) -> bytes:
    """Much that packs into little: an array or the list of contents; or one array named very often."""

    def change(parts: dict[str, bytes]) -> None:
        name = sorted(parts)[int(rng.integers(len(parts)))]
        parts[name] += bytes(int(_pick((10_000, 1 << 22, 1 << 25), rng)))
        if rng.random() < 0.3:
            schema = json.loads(parts["schema.json"])
            arrays = [n for n in parts if n.endswith(".npy")]
            node = {"__class__": "ndarray", "__module__": "numpy", "__loader__": "NdArrayNode", "type": "numpy"}
            content = [node | {"__id__": 1 + i, "file": arrays[0]} for i in range(20_000)]
            schema["content"] = {"__class__": "list", "__module__": "builtins", "__loader__": "ListNode"}
            schema["content"] |= {"__id__": 0, "content": content}
            parts["schema.json"] = json.dumps(schema).encode()

    return _repacked(data, change)


_HUGE = 3 << 29  # bytes: more than one input may take


def _huge(data: bytes, rng: Rng) -> bytes:
    """An array of an archive that says it has very many numbers and has them, all of them zero."""

    def change(parts: dict[str, bytes]) -> None:
        names = sorted(name for name in parts if name.endswith(".npy") and parts[name].startswith(b"\x93NUMPY"))
        name = names[int(rng.integers(len(names)))]
        reported = re.sub(rb"'shape': \((\d+)", rb"'shape': (%d" % (_HUGE // 64), parts[name][10:128])
        parts[name] = parts[name][:8] + struct.pack("<H", len(reported)) + reported
        huge.append(name)

    huge: list[str] = []
    packed = _repacked(data, change)
    return _with_zeros(packed, huge[0].encode()) if huge else packed


def _with_zeros(packed: bytes, name: bytes) -> bytes:
    """An archive in which one file has gigabytes of zeros behind what it holds; sizes and checksum fit."""
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        parts = [(info.filename.encode(), archive.read(info)) for info in archive.infolist()]
    whole, listed = b"", b""
    for called, content in parts:
        packer = zlib.compressobj(1, zlib.DEFLATED, -15)
        body, size, crc = packer.compress(content), len(content), zlib.crc32(content)
        if called == name:
            body += packer.flush(zlib.Z_FULL_FLUSH) + fuzz_records.bomb("zlib", _HUGE >> 20)[2:-4]
            size, crc = size + _HUGE, fuzz_records.crc_of_zeros(_HUGE, crc)
        else:
            body += packer.flush()
        about = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 33, crc, len(body), size, len(called), 0)
        listed += b"PK\1\2" + struct.pack("<H", 20) + about + struct.pack("<HHHII", 0, 0, 0, 0, len(whole)) + called
        whole += b"PK\3\4" + about + called + body
    end = struct.pack("<HHHHIIH", 0, 0, len(parts), len(parts), len(listed), len(whole), 0)
    return whole + listed + b"PK\5\6" + end


def _schema(data: bytes, rng: Rng) -> bytes:
    def change(parts: dict[str, bytes]) -> None:
        parts["schema.json"] = _json(parts["schema.json"], rng)

    return _repacked(data, change)


def _json(text: bytes, rng: Rng) -> bytes:
    """A JSON text with one value in another's place, or nested."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):  # an earlier change has damaged it
        return text
    spots: list[tuple[Any, Any]] = []
    waiting = [document]
    while waiting:
        node = waiting.pop()
        inside = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, value in inside:
            spots.append((node, key))
            waiting.append(value)
    values: tuple[Any, ...] = (
        None,
        -1,
        0,
        1 << 70,
        1e308,
        "",
        "x" * 10_000,
        [],
        {},
        [[]],
        True,
        float("nan"),
        float("inf"),
        3,
        "3",
    )
    if spots:
        node, key = spots[int(rng.integers(len(spots)))]
        if rng.random() < 0.2 and isinstance(node, dict):
            del node[key]
        else:
            node[key] = _pick(values, rng)
    made = json.dumps(document).encode()
    deep = int(_pick((0, 0, 0, 50, 500, 20_000), rng))
    return made.replace(b": ", b": " + b'{"a": ' * deep, 1) if deep else made


def _many(text: bytes, rng: Rng) -> bytes:
    """A JSON text in which one list, or object, has very many members: texts in them are all different."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):  # an earlier change has damaged it
        return text
    spots, waiting = [], [document]
    while waiting:
        node = waiting.pop()
        inside = list(node.values()) if isinstance(node, dict) else node if isinstance(node, list) else []
        waiting += inside
        if inside:
            spots.append(node)
    if not spots:
        return text
    node = spots[int(rng.integers(len(spots)))]
    key = sorted(node)[0] if isinstance(node, dict) else 0
    member = json.dumps(node[key])
    count = min(int(_pick((50, 5000, 200_000), rng)), _MOST_BYTES // (len(member) + len(str(key)) + 8))
    if isinstance(node, dict):
        node.update({f"{key}{i}": node[key] for i in range(count)})
    else:
        places = [found.end() - 1 for found in re.finditer(r'"name": "[^"]*"', member)]
        at = places[0] if places else member.rfind('"')
        node += [json.loads(f"{member[:at]}{i}{member[at:]}" if at > 0 else member) for i in range(count)]
    return json.dumps(document).encode()


def _map_header(data: bytes, rng: Rng) -> bytes:
    first, _, rest = data.partition(b"\n")
    header, _, body = rest.partition(b"\n")
    return first + b"\n" + _json(header, rng) + b"\n" + body


def _map_body(data: bytes, rng: Rng) -> bytes:
    """Other numbers, packed or not, with length and checksum of these."""
    first, _, rest = data.partition(b"\n")
    header, _, body = rest.partition(b"\n")
    if rng.random() < 0.5:
        body = _overwrite(body, rng)
    else:
        try:
            body = lzma.compress(_overwrite(lzma.decompress(body), rng))
        except lzma.LZMAError:  # an earlier change has damaged it
            return data
    for name, value in ((b"crc32", zlib.crc32(body)), (b"bytes", len(body))):
        header = re.sub(rb'("%s": )\d+' % name, rb"\g<1>%d" % value, header)
    return first + b"\n" + header + b"\n" + body


_BYTES: tuple[Change, ...] = (_flip, _overwrite, _cut, _repeat, _noise, fuzz_records.numbers_changed)
_TEXT = (_word, _word, _lines, _many_lines, _dialect, _encoding)
_YAML = (_node, _node, _key, _laughing)
_ARCHIVE = (_array, _bomb, _huge, _schema)
_MAP = (_map_header, _map_body)
_OF_RECORDS: dict[str, Callable[[bytes, Rng, Change], bytes]] = {
    "bag": fuzz_records.ros1_changed,
    "mcap": fuzz_records.mcap_changed,
    "db3": fuzz_records.sqlite_changed,
    "zstd": fuzz_records.zstd_changed,
    "mkv": fuzz_records.matroska_changed,
    "journal": fuzz_records.journal_changed,
    "sens": fuzz_records.sens_changed,
    "oni": fuzz_records.numbers_or_bytes_changed,
    "serial": fuzz_records.serial_changed,
}
