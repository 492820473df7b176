"""Model files: the same answers after loading; no other version, areas or description; nothing that could act."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import skops.io
from places.made import NAMES, QUICK, drive_through, frame_of, trained
from sklearn.ensemble import RandomForestClassifier
from sklearn.preprocessing import FunctionTransformer

from wheelsight.core.errors import OutputError, PlaceError
from wheelsight.places import HistogramDescriber, LayoutDescriber, PlaceModel
from wheelsight.places import model as storage
from wheelsight_papers import describe_all, train_places


@pytest.fixture
def path(tmp_path: Path, rng) -> Path:
    """A sound model's file."""
    trained().save(tmp_path / "places.skops")
    return tmp_path / "places.skops"


def rewritten(path: Path, **changes: object) -> Path:
    """The file with entries of its document changed, and everything else as it was."""
    document = skops.io.load(path)
    path.write_bytes(skops.io.dumps(document | changes))
    return path


def with_schema(path: Path, change) -> Path:
    """The file with the text of its table of contents changed."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts["schema.json"] = change(parts["schema.json"].decode()).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return path


def refused(path: Path, problem: str) -> None:
    with pytest.raises(PlaceError, match=rf"^\S*{path.name}: {problem}") as caught:
        PlaceModel.load(path)
    assert "\n" not in str(caught.value)


def test_what_is_loaded_answers_as_what_was_saved(tmp_path: Path, rng):
    model = trained()
    model.save(tmp_path / "places.skops")
    loaded = PlaceModel.load(tmp_path / "places.skops", areas=NAMES)
    for frame in drive_through((0, 1, 2), 4, rng)[0]:
        one, other = model.predict(frame), loaded.predict(frame)
        np.testing.assert_array_equal(one.probabilities, other.probabilities)
        assert (one.area_index, one.reason) == (other.area_index, other.reason)
    for name in ("area_names", "scale", "least_confidence", "settings", "figures", "frame_size"):
        assert getattr(loaded, name) == getattr(model, name), name
    assert loaded.describer.settings == model.describer.settings
    np.testing.assert_array_equal(loaded.area_shares, model.area_shares)


@pytest.mark.parametrize("describer", [HistogramDescriber(), LayoutDescriber()])
def test_the_description_is_saved_with_the_model(tmp_path: Path, rng, describer):
    frames, labels = drive_through((0, 1, 2), 12, rng)
    model = train_places(describe_all(frames, describer).features, labels, NAMES, describer, QUICK)
    model.save(tmp_path / "places.skops")
    loaded = PlaceModel.load(tmp_path / "places.skops")
    frame = frame_of(1, rng)
    np.testing.assert_array_equal(loaded.predict(frame).probabilities, model.predict(frame).probabilities)
    assert type(loaded.describer) is type(describer)
    assert loaded.frame_size is None


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path, rng):
    with pytest.raises(OutputError, match=r"places\.skops"):
        trained().save(tmp_path / "nowhere" / "places.skops")


def test_other_areas_are_refused_by_file(path: Path):
    with pytest.raises(PlaceError, match=r"places\.skops: the model has no area 'attic'"):
        PlaceModel.load(path, areas=(*NAMES, "attic"))


def test_another_version_is_refused(path: Path):
    refused(rewritten(path, format="wheelsight-places-9"), "is of version 'wheelsight-places-9'")


def test_another_description_is_refused(path: Path):
    document = skops.io.load(path)
    changed = document["describer"] | {"bins": 50}
    refused(rewritten(path, describer=changed), "describes frames with 100 numbers, but its forest takes 32")
    refused(rewritten(path, describer={"kind": "ferns"}), "no description is called 'ferns'")
    refused(rewritten(path, describer=changed | {"eyes": 2}), "description settings: unknown setting eyes")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"area_names": ["corridor", "hall"]}, "names 2 areas, but its forest has 3"),
        ({"area_shares": [0.5, 0.5]}, "names 3 areas"),
        ({"scale": {"temperature": 0.0, "blend": 0.1}}, "has impossible probabilities"),
        ({"scale": {"temperature": float("nan"), "blend": 0.1}}, "has impossible probabilities"),
        ({"least_confidence": 3.0}, "has impossible probabilities"),
        ({"settings": {"trees": -1}}, "settings: "),
        ({"forest": {}}, "is damaged: KeyError"),
        ({"describer": "histograms"}, "is damaged"),
        ({"figures": None}, "is damaged"),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(path: Path, changes, problem):
    refused(rewritten(path, **changes), problem)


def test_trees_that_lead_out_of_the_arrays_are_refused(path: Path):
    forest = skops.io.load(path)["forest"]
    for name, array in (("left", forest["left"] * 0), ("feature", forest["feature"] + 1000)):
        refused(rewritten(path, forest=forest | {name: array}), "its arrays do not make trees")


def test_what_is_no_model_is_refused(tmp_path: Path):
    path = tmp_path / "places.skops"
    for data in (b"", b"areas: []", bytes(range(256)) * 9, skops.io.dumps([1, 2]), skops.io.dumps({"a": 1})):
        path.write_bytes(data)
        refused(path, "is no model of places")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("letter.txt", "hello")
    refused(path, "is no model of places")
    refused(tmp_path / "nothing.skops", "cannot be read: No such file")


def test_a_file_cut_short_anywhere_is_refused(path: Path):
    data = path.read_bytes()
    for share in (0.1, 0.5, 0.9, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        refused(path, "is (no model of places|damaged)")


def test_a_file_with_flipped_bytes_never_gives_another_model(path: Path, rng):
    data, frame = path.read_bytes(), frame_of(1, rng)
    wanted = PlaceModel.load(path).predict(frame).probabilities
    for place in rng.integers(0, len(data), 40):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            np.testing.assert_array_equal(PlaceModel.load(path).predict(frame).probabilities, wanted)
        except PlaceError as error:
            assert path.name in str(error)  # noqa: PT017 - a flipped byte may also fall where it does no harm


class Bomb:
    """Writes a file wherever it is unpickled."""

    def __init__(self, witness: Path) -> None:
        self.witness = witness

    def __reduce__(self):
        return Path.write_text, (self.witness, "it went off")


@pytest.fixture
def witness(tmp_path: Path) -> Path:
    return tmp_path / "witness"


def test_a_pickle_is_refused_unread(tmp_path: Path, witness: Path):
    data = pickle.dumps(Bomb(witness))
    pickle.loads(data)
    assert witness.exists(), "the bomb works"
    witness.unlink()
    path = tmp_path / "places.skops"
    path.write_bytes(data)
    refused(path, "is no model of places")
    assert not witness.exists()


def test_an_array_that_is_a_pickle_is_refused(path: Path, witness: Path):
    buffer = io.BytesIO()
    np.save(buffer, np.array([Bomb(witness)], object), allow_pickle=True)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, buffer.getvalue() if name.endswith(".npy") else data)
    refused(path, "holds .*, an array of another type or size than stated")
    assert not witness.exists()


def act(_: object) -> None:
    raise AssertionError("a function from a file was called")


@pytest.mark.parametrize(
    "smuggled",
    [
        np.sum,  # skops trusts it
        act,
        print,
        FunctionTransformer(act),
        RandomForestClassifier(2).fit([[0.0], [1.0]], [0, 1]),
        np.random.default_rng(0),
        (1, 2),
        {3: "not a name"},
    ],
    ids=["numpy function", "function", "builtin", "transformer", "estimator", "generator", "tuple", "odd key"],
)
def test_a_file_that_holds_anything_but_values_is_refused_unread(path: Path, monkeypatch, smuggled):
    rewritten(path, extra=smuggled)
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, "holds a .*, which no model of places does")


def test_a_table_of_contents_that_names_another_type_is_refused_unread(path: Path, monkeypatch):
    with_schema(path, lambda text: text.replace('"__class__": "ndarray"', '"__class__": "system"', 1))
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, r"holds a numpy\.system")


def test_a_loader_that_hides_in_a_value_is_found(path: Path, monkeypatch):
    def hide(text: str) -> str:
        schema = json.loads(text)
        schema["content"]["format"]["hidden"] = {"__loader__": "FunctionNode", "content": "os.system"}
        return json.dumps(schema)

    with_schema(path, hide)
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, "holds a .*FunctionNode")


def test_a_file_that_unpacks_to_too_much_is_refused_unread(path: Path, monkeypatch):
    monkeypatch.setattr(storage, "_MOST_BYTES", 1000)
    refused(path, "unpacks to more than a model of places ever needs")


def with_array(path: Path, header: bytes, body: bytes = b"") -> None:
    """The file with another header, and body, of one of its arrays."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = next(name for name in parts if name.endswith(".npy"))
    parts[name] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


@pytest.mark.parametrize(
    ("kind", "shape"),
    [("'<f8'", "(10000000000,)"), ("'|V0'", "(10000000000,)"), ("'|O'", "(1,)"), ("'<f8'", "(-1,)"), ("'<U1'", "(1,)")],
)
def test_an_array_that_is_not_what_its_header_says_is_refused_unread(path: Path, monkeypatch, kind: str, shape: str):
    with_array(path, f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}}}\n".encode())
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, "holds .*npy, an array of another type or size than stated")


def test_arrays_that_unpack_to_gigabytes_are_refused_unread(path: Path, monkeypatch):
    with_array(path, b"{'descr': '|u1', 'fortran_order': False, 'shape': (300000000,)}\n", bytes(300_000_000))
    assert path.stat().st_size < 1_000_000
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, "unpacks to more than a model of places ever needs")


def test_one_array_that_is_named_many_times_over_counts_as_often(path: Path, monkeypatch):
    with_array(path, b"{'descr': '|u1', 'fortran_order': False, 'shape': (30000000,)}\n", bytes(30_000_000))

    def repeat(text: str) -> str:
        schema = json.loads(text)
        node = {"__class__": "ndarray", "__module__": "numpy", "__loader__": "NdArrayNode", "type": "numpy"}
        with zipfile.ZipFile(path) as archive:
            name = max(archive.infolist(), key=lambda entry: entry.file_size).filename
        schema["content"]["more"] = {"__class__": "list", "__module__": "builtins", "__loader__": "ListNode"}
        schema["content"]["more"] |= {"content": [node | {"file": name} for _ in range(10)]}
        return json.dumps(schema)

    with_schema(path, repeat)
    monkeypatch.setattr(skops.io, "loads", act)
    refused(path, "unpacks to more than a model of places ever needs")


@pytest.mark.parametrize("packing", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_packing_that_cannot_be_unpacked_in_parts_is_refused(path: Path, packing: int):
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", packing) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    refused(path, "is packed in a way that models of places are not")


def test_an_archive_of_very_many_files_is_refused_unread(path: Path, monkeypatch):
    with zipfile.ZipFile(path, "a") as archive:
        for number in range(1001):
            archive.writestr(str(number), b"")
    monkeypatch.setattr(zipfile, "ZipFile", act)
    refused(path, "lists more than a model of places ever holds")


def test_a_contents_table_of_a_gigabyte_is_refused_unread(path: Path):
    with_schema(path, lambda text: text + " " * 2_000_000)
    refused(path, "lists more than a model of places ever holds")


def test_a_contents_table_nested_without_end_is_refused(path: Path):
    with_schema(path, lambda _: "[" * 200_000 + "]" * 200_000)
    refused(path, "its list of contents is nested too deeply")
