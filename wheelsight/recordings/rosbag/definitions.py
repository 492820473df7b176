"""What a bag says of its topics and the types of their messages, and programs that read these types.

A definition is text from a stranger that becomes a program: its length, its fields and what they repeat are bounded.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from wheelsight.errors import RecordingError
from wheelsight.extras import needed

# The longest of those that are read, Odometry with all comments, has 8 kB as text and 20 kB as IDL.
LONGEST_DEFINITION = 1 << 16
# Fields of fields are counted: an Odometry has 90, 72 of them in covariances.
_MOST_FIELDS = 4096
_IDL_RULE = "=" * 80 + "\n"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
MOST_CONNECTIONS = 10_000  # a robot's bag has some hundred


# Metres, radians, their rates, or pixels: beyond, squares and products of damaged numbers overflow.
_LARGEST = 1e9


def are_measured(values: Iterable[float]) -> bool:
    """Whether all of a message's numbers can have been measured: none is NaN, infinite or beyond 1e9."""
    return all(abs(value) <= _LARGEST for value in values)


class Connection(NamedTuple):
    """A topic of a bag, as one writer wrote it.

    Attributes:
        id: in the file.
        topic: its name.
        msgtype: such as "sensor_msgs/msg/Image".
        language: of the definition: "MSG", "IDL", or "NONE" where there is none.
        definition: of the type.
        msgcount: messages, by the index.
    """

    id: int
    topic: str
    msgtype: str
    language: str
    definition: str
    msgcount: int


# A store makes a program for each type: bags of one robot, which define theirs alike, share them.
@lru_cache(maxsize=128)
def store_of(type_: str, language: str, definition: str, is_ros1: bool) -> Any:
    """A store that knows a type: by the bag's definition, else by ROS's. Raises RecordingError, or as rosbags does."""
    typesys = needed("rosbags.typesys")
    if language == "NONE":
        return typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.LATEST)
    if len(definition) > LONGEST_DEFINITION:
        raise RecordingError(f"its definition is longer than {LONGEST_DEFINITION >> 10} kB")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    types = _defined(type_, language, definition, typesys)
    known = {**store.fielddefs, **types}
    _check(type_, known)
    standard = dict(typesys.get_typestore(typesys.Stores.ROS1_NOETIC if is_ros1 else typesys.Stores.LATEST).fielddefs)
    for name in TF:
        standard.setdefault(name, typesys.get_types_from_msg(_TRANSFORMS, name)[name])
    if type_ in standard:
        _compare(type_, known, type_, standard)
    store.register(types)
    return store


def _defined(type_: str, language: str, definition: str, typesys: Any) -> dict[str, Any]:
    """The types of a definition in ROS's own language, or in one or several of IDL."""
    if language == "MSG":
        return dict(typesys.get_types_from_msg(definition, type_))
    parts = [part.partition("\n")[2] for part in definition.split(_IDL_RULE) if part.startswith("IDL: ")]
    return {name: of for part in parts or [definition] for name, of in typesys.get_types_from_idl(part).items()}


def _check(type_: str, types: Mapping[str, Any]) -> None:
    """Raise RecordingError for a type that contains itself, has too many fields, or repeats one without any."""
    counts: dict[str, int | None] = {}

    def fields_of(name: str) -> int:
        """How many plain values a message has where each sequence has one element."""
        if name not in types:  # rosbags refuses it by name
            return 1
        if name not in counts:
            counts[name] = None
            counts[name] = sum(values_of(field) for _, field in types[name][1])
        count = counts[name]
        if count is None:
            raise RecordingError(f"its definition has a type that contains itself: {name}")
        if count > _MOST_FIELDS:
            raise RecordingError(f"its definition has more than {_MOST_FIELDS} fields")
        return count

    def values_of(field: Any) -> int:
        kind, what = field
        if kind.name in ("BASE", "NAME"):
            return 1 if kind.name == "BASE" else fields_of(what)
        element, size = what
        count = values_of(element)
        if not count:
            raise RecordingError("its definition repeats a type without fields")
        return count * size if kind.name == "ARRAY" else count

    fields_of(type_)


def _compare(type_: str, types: Mapping[str, Any], name: str, standard: Mapping[str, Any]) -> None:
    """Raise RecordingError for a type that lacks a field of ROS's, or has it otherwise; it may have more fields."""
    found = dict(types[type_][1]) if type_ in types else {}
    for field, wanted in standard[name][1]:
        if field not in found or not _is_alike(found[field], wanted):
            raise RecordingError(f"its definition of {type_} does not have ROS's field {field}")
        (kind, what), (_, of_ros) = _element(found[field]), _element(wanted)
        if kind.name == "NAME":
            _compare(what, types, of_ros, standard)


def _is_alike(found: Any, wanted: Any) -> bool:
    """Whether both are numbers, text or messages, or as many of them."""
    if found[0].name not in (wanted[0].name, *(("ARRAY",) if wanted[0].name == "SEQUENCE" else ())):
        return False
    if wanted[0].name == "ARRAY" and found[1][1] != wanted[1][1]:
        return False
    (kind, what), (kind_of_ros, of_ros) = _element(found), _element(wanted)
    is_text = kind.name == "BASE" and ("string" in what[0]) != ("string" in of_ros[0])
    return bool(kind is kind_of_ros and not is_text)


def _element(field: Any) -> Any:
    return field[1][0] if field[0].name in ("ARRAY", "SEQUENCE") else field
