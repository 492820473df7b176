"""DdsPeer: a node of ROS 2 over DDS, by Cyclone DDS, without a ROS installation.

Names and types follow https://design.ros2.org/articles/topic_and_service_names.html: `rt/odom` is /odom, and
`nav_msgs::msg::dds_::Odometry_` is nav_msgs/msg/Odometry. Messages are the CDR of the bags' writer. Services are those
of rmw_cyclonedds (https://github.com/ros2/rmw_cyclonedds): before a request and its response stand the client's number
of 64 bits and that of the request. Releases of ROS 2 with Cyclone DDS 0.10 announce no types, and take ours by their
names. Later ones announce types without these numbers, which do not match. Nodes are announced as rmw_dds_common
describes it.
"""

from __future__ import annotations

import ipaddress
import os
import re
import secrets
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import needed
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import NODES_TOPIC, TOPICS, Flow, Topic
from wheelsight_ros2.actions import FEEDBACK, SERVICES, STATUS, ActionService, NavigateServer

# Messages of a topic are taken at most so often: of a flood the newest.
TAKE_S = 0.01
_WAIT_S, _ENDS_S = 0.2, 5.0
# How long a writer may wait for a reader that does not acknowledge: the robot's thread must not.
_BLOCKING_S = 0.001
# How long a request waits until its client can take the response.
_MATCHES_S = 0.1
DEPTH, _MOST_DOMAIN = 10, 232
NODE = "wheelsight"
_REQUEST, _HEADER = 16, 4  # bytes of the numbers before a request, and of CDR's encoding
_MS = 1_000_000
_NODES = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_DDS_TYPE = re.compile(r"(\w+)::msg::dds_::(\w+)_")
# Participants of this program, whose own topics are no input.
_OWN: set[Any] = set()
# Open domains, and how many participants of this program each has: a domain that is closed closes all of them.
_DOMAINS: dict[int, tuple[Any, int]] = {}
_LOCK = threading.Lock()
# How often new topics are looked for, and how many at once.
_MEETS_S, _MOST_FOUND = 0.1, 100
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")
# Programs on this computer that are found without multicast, which the loopback interface has not.
_MOST_PARTICIPANTS = 32


def check_names(domain: int, namespace: str) -> None:
    """Raise ConfigError for a domain or a namespace that ROS 2 does not have."""
    if not 0 <= domain <= _MOST_DOMAIN:
        raise ConfigError(f"--domain is {domain}", fix=f"0 to {_MOST_DOMAIN}")
    if not _NAMESPACE.fullmatch(namespace):
        raise ConfigError(f"--namespace is {namespace!r}", fix="such as /chair: letters, digits and _ after each /")


class DdsPeer:
    """A participant with a writer for each live topic and a reader for each input; see `Peer` and `ActionPeer`.

    Args:
        domain: of ROS 2.
        namespace: before all topics.
        interface: name or address of the network; None for this computer alone.
        on_cdr: called with topic, type and CDR of each input, from one thread.

    Raises:
        ConfigError: the interface cannot be used.
    """

    def __init__(
        self, domain: int, namespace: str, interface: str | None, on_cdr: Callable[[str, str, bytes], None]
    ) -> None:
        check_names(domain, namespace)
        self._dds, self._on_cdr = needed("cyclonedds.core"), on_cdr
        self.name = f"DDS, domain {domain}, {_where(interface)}"
        self._domain, self._participant = domain, _joined(domain, interface)
        _OWN.add(self._participant.guid)
        self._writers: dict[str, Any] = {}
        self._readers: list[tuple[Topic, Any]] = []
        self._services: dict[ActionService, tuple[Any, Any]] = {}
        self._namespace, self._types = namespace, Messages(is_ros1=False).types
        self._action: NavigateServer | None = None
        for topic in TOPICS.values():
            if topic.flow in (Flow.INPUT, Flow.COMMAND):
                self._readers.append((topic, self._reader(f"rt{namespace}{topic.name}", topic.type, topic.flow)))
            elif topic.is_live:
                self._writers[topic.name] = self._writer(f"rt{namespace}{topic.name}", topic.type, topic.flow)
        self._nodes = self._writer(NODES_TOPIC, _NODES, Flow.LATCHED)
        self._announce()
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="wheelsight-dds", daemon=True)
        self._thread.start()

    def serve(self, action: NavigateServer) -> None:
        """Offer an action from now on."""
        for service in SERVICES:
            # Client and service name their two ends alike, so that the other knows which belong together.
            id_ = ".".join(f"{part:x}" for part in secrets.token_bytes(16))
            about, name = f"serviceid={id_};", f"{self._namespace}{service.name}"
            writer = self._writer(f"rr{name}Reply", f"{service.type}_Response", Flow.RELIABLE, about)
            self._services[service] = (
                self._reader(f"rq{name}Request", f"{service.type}_Request", Flow.RELIABLE, about),
                writer,
            )
        for topic in (FEEDBACK, STATUS):
            self._writers[topic.name] = self._writer(f"rt{self._namespace}{topic.name}", topic.type, topic.flow)
        self._announce()
        action.open(self)
        self._action = action

    def wants(self, topic: str) -> bool:
        """See `Peer`."""
        return topic in self._writers and bool(self._writers[topic].get_matched_subscriptions())

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """See `Peer`. A message is dropped where a reader of a reliable topic does not acknowledge the earlier ones."""
        writer = self._writers.get(topic.name)
        if writer is None:
            return
        self._write(writer, _sample(topic.type, data))

    def reply(self, service: ActionService, request: bytes, data: bytes) -> None:
        """See `ActionPeer`."""
        _, writer = self._services[service]
        self._write(writer, _sample(f"{service.type}_Response", data[:_HEADER] + request + data[_HEADER:]))

    def close(self) -> None:
        """See `Peer`."""
        self._is_over.set()
        self._thread.join(_ENDS_S)
        self._readers.clear()
        self._writers.clear()
        self._services.clear()
        # What nothing refers to is deleted; the participant with its topics at once.
        _OWN.discard(self._participant.guid)
        del self._nodes, self._participant
        _left(self._domain)

    def _write(self, writer: Any, sample: Any) -> None:
        try:
            writer.write(sample)
        except self._dds.DDSException as error:
            if error.code != self._dds.DDSException.DDS_RETCODE_TIMEOUT:
                raise

    def _topic(self, name: str, type_: str) -> Any:
        return needed("cyclonedds.topic").Topic(self._participant, name, _kind(type_), qos=None)

    def _writer(self, name: str, type_: str, flow: Flow, about: str = "") -> Any:
        qos = self._qos(flow, about or f"typehash={self._types.hash_rihs01(type_)};")
        return needed("cyclonedds.pub").DataWriter(self._participant, self._topic(name, type_), qos=qos)

    def _reader(self, name: str, type_: str, flow: Flow, about: str = "") -> Any:
        qos = self._qos(flow, about or f"typehash={self._types.hash_rihs01(type_)};")
        return needed("cyclonedds.sub").DataReader(self._participant, self._topic(name, type_), qos=qos)

    def _announce(self) -> None:
        """Name the node and its endpoints, for `ros2 node`."""
        make = self._types.types

        def gid(entity: Any) -> Any:
            return make["rmw_dds_common/msg/Gid"](np.frombuffer(entity.guid.bytes, np.uint8))

        readers = [*(reader for _, reader in self._readers), *(reader for reader, _ in self._services.values())]
        writers = [*self._writers.values(), *(writer for _, writer in self._services.values())]
        ends = [[gid(one) for one in entities] for entities in (readers, writers)]
        node = make["rmw_dds_common/msg/NodeEntitiesInfo"](self._namespace or "/", NODE, *ends)
        message = make[_NODES](gid(self._participant), [node])
        self._write(self._nodes, _sample(_NODES, bytes(self._types.serialize_cdr(message, _NODES))))

    def _qos(self, flow: Flow, about: str) -> Any:
        policy = self._dds.Policy
        reliable = policy.Reliability.Reliable(round(_BLOCKING_S * 1000 * _MS))
        kinds = {
            Flow.SENSOR: (policy.Reliability.BestEffort, policy.Durability.Volatile, 1),
            Flow.RELIABLE: (reliable, policy.Durability.Volatile, DEPTH),
            Flow.LATCHED: (reliable, policy.Durability.TransientLocal, 1),
            Flow.INPUT: (reliable, policy.Durability.Volatile, 1),
            Flow.COMMAND: (policy.Reliability.BestEffort, policy.Durability.Volatile, 1),
        }
        reliability, durability, depth = kinds[flow]
        plain = policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False)
        named = policy.Userdata(about.encode())
        return self._dds.Qos(reliability, durability, policy.History.KeepLast(depth), plain, named)

    def _receive(self) -> None:
        """The thread: take inputs, of each topic the newest; and requests."""
        core = self._dds
        waiting, attached = core.WaitSet(self._participant), 0
        state = core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Alive
        while not self._is_over.is_set():
            readers = [*(reader for _, reader in self._readers), *(reader for reader, _ in self._services.values())]
            for reader in readers[attached:]:
                waiting.attach(core.ReadCondition(reader, state))
            attached = len(readers)
            with suppress(core.DDSException):
                if not waiting.wait(round(_WAIT_S * 1000 * _MS)):
                    continue
                for topic, reader in self._readers:
                    for sample in reader.take(1):
                        if isinstance(sample, _Received):
                            self._on_cdr(topic.name, topic.type, sample.data)
                for service in tuple(self._services) if self._action is not None else ():
                    self._take_requests(service)
            time.sleep(TAKE_S)

    def _take_requests(self, service: ActionService) -> None:
        reader, writer = self._services[service]
        for sample in reader.take(DEPTH):
            if not isinstance(sample, _Received) or self._action is None:
                continue
            data = sample.data
            try:
                order = "<" if data[1] & 1 else ">"
                request = struct.pack("<Qq", *struct.unpack_from(f"{order}Qq", data, _HEADER))
                body = data[:_HEADER] + data[_HEADER + _REQUEST :]
                message = self._types.deserialize_cdr(body, f"{service.type}_Request")
            except Exception as error:  # rosbags raises many kinds for bytes that are no message
                self._action.refuse(f"a request of {service.name} is none ({type(error).__name__})")
                continue
            client = reader.get_matched_publication_data(sample.sample_info.publication_handle)
            ends_s = time.monotonic() + _MATCHES_S
            while client is not None and time.monotonic() < ends_s:
                ends = (writer.get_matched_subscription_data(one) for one in writer.get_matched_subscriptions())
                if any(one is not None and one.participant_key == client.participant_key for one in ends):
                    break
                time.sleep(TAKE_S)
            self._action.request(service, request, message)


class DdsListener:
    """Follows topics that other programs publish, from when each begins.

    Args:
        domain: of ROS 2. Its network is that of CYCLONEDDS_URI, else this computer alone.
        takes: whether to follow a topic of a type.
        on_message: called from one thread with topic, type, time of receipt in nanoseconds, and CDR.

    Attributes:
        seen: all topics so far.

    Raises:
        ConfigError: the domain does not exist, or the network cannot be used.
    """

    def __init__(
        self, domain: int, takes: Callable[[str, str], bool], on_message: Callable[[str, str, int, bytes], None]
    ) -> None:
        check_names(domain, "")
        self._dds, self._takes, self._on_message = needed("cyclonedds.core"), takes, on_message
        self._types, self.seen = Messages(is_ros1=False).types, set[str]()
        self._domain, self._participant = domain, _joined(domain, None)
        builtin = needed("cyclonedds.builtin")
        self._found = builtin.BuiltinDataReader(self._participant, builtin.BuiltinTopicDcpsPublication)
        self._readers: dict[str, tuple[str, Any]] = {}
        self._kept: set[str] | None = None
        self._is_paused = False
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="wheelsight-dds-in", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Drop messages until `keep`."""
        self._is_paused = True

    def keep(self, topics: set[str]) -> None:
        """Follow these topics alone from now on."""
        self._kept, self._is_paused = topics, False

    def close(self) -> None:
        """End all; may be called twice."""
        if self._is_over.is_set():
            return
        self._is_over.set()
        self._thread.join(_ENDS_S)
        self._readers.clear()
        self._found = self._participant = None
        _left(self._domain)

    def _listen(self) -> None:
        core = self._dds
        waiting = core.WaitSet(self._participant)
        conditions: dict[str, Any] = {}
        while not self._is_over.is_set():
            with suppress(core.DDSException):
                for end in self._found.take(_MOST_FOUND):
                    self._meet(end)
                self._attach(waiting, conditions)
                waiting.wait(round(_MEETS_S * 1000 * _MS))
                for name, (type_, reader) in self._readers.items():
                    for sample in reader.take(DEPTH):
                        if isinstance(sample, _Received) and not self._is_paused:
                            self._on_message(name, type_, time.time_ns(), sample.data)

    def _attach(self, waiting: Any, conditions: dict[str, Any]) -> None:
        """Wait for all readers but those that are not kept, which end."""
        core, kept = self._dds, self._kept
        state = core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Alive
        for name in [*self._readers]:
            if kept is not None and name not in kept:
                if name in conditions:
                    waiting.detach(conditions.pop(name))
                del self._readers[name]
            elif name not in conditions:
                conditions[name] = core.ReadCondition(self._readers[name][1], state)
                waiting.attach(conditions[name])

    def _meet(self, end: Any) -> None:
        """Follow the topic of a publisher, if it is wanted, as reliably as it is offered."""
        name, type_ = str(getattr(end, "topic_name", "")), _ros_type(str(getattr(end, "type_name", "")))
        if not name.startswith("rt/") or type_ is None or end.participant_key in _OWN:
            return
        name = name[2:]
        self.seen.add(name)
        is_wanted = self._takes(name, type_) if self._kept is None else name in self._kept
        if not is_wanted or name in self._readers or type_ not in self._types.fielddefs:
            return
        policy, offered = self._dds.Policy, end.qos
        kinds = [policy.Reliability.BestEffort, policy.Durability.Volatile]
        if isinstance(offered[policy.Reliability], policy.Reliability.Reliable):
            kinds[0] = policy.Reliability.Reliable(round(_BLOCKING_S * 1000 * _MS))
        if offered[policy.Durability] == policy.Durability.TransientLocal:
            kinds[1] = policy.Durability.TransientLocal
        qos = self._dds.Qos(*kinds, policy.History.KeepLast(DEPTH), policy.IgnoreLocal.Process)
        topic = needed("cyclonedds.topic").Topic(self._participant, f"rt{name}", _kind(type_), qos=None)
        self._readers[name] = type_, needed("cyclonedds.sub").DataReader(self._participant, topic, qos=qos)


def _ros_type(name: str) -> str | None:
    """nav_msgs/msg/Odometry of nav_msgs::msg::dds_::Odometry_; None for a type that is none of ROS 2."""
    match = _DDS_TYPE.fullmatch(name)
    return f"{match[1]}/msg/{match[2]}" if match else None


def _where(interface: str | None) -> str:
    return "this computer alone" if interface is None else interface


def _joined(domain: int, interface: str | None) -> Any:
    """A participant of a domain, which the first one configures and the last one closes. Raises ConfigError."""
    core, domains = needed("cyclonedds.core"), needed("cyclonedds.domain")
    with _LOCK:
        opened, users = _DOMAINS.get(domain, (None, 0))
        try:
            if not users and (interface is not None or not os.environ.get("CYCLONEDDS_URI")):
                opened = domains.Domain(domain, configuration(interface))
            participant = domains.DomainParticipant(domain, core.Qos(core.Policy.Userdata(b"enclave=/;")))
        except core.DDSException as error:
            fix = "a network of ip address, or leave out --interface"
            raise ConfigError(f"DDS cannot use {_where(interface)}: {error}", fix=fix) from error
        _DOMAINS[domain] = opened, users + 1
        return participant


def _left(domain: int) -> None:
    """Close a domain after its last participant of this program."""
    with _LOCK:
        opened, users = _DOMAINS.pop(domain)
        if users > 1:
            _DOMAINS[domain] = opened, users - 1


def configuration(interface: str | None) -> str:
    """Cyclone DDS's configuration for a network interface by name or address; None for loopback."""
    if interface is None:
        peers = '<Peers><Peer Address="127.0.0.1"/></Peers>'
        most = f"<MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>"
        more = f"<Discovery><ParticipantIndex>auto</ParticipantIndex>{most}{peers}</Discovery>"
        network = 'address="127.0.0.1"'
        multicast = "<AllowMulticast>false</AllowMulticast>"
    else:
        kind = "address" if _is_address(interface) else "name"
        network, more, multicast = f"{kind}={quoteattr(interface)}", "", ""
    general = f"<General><Interfaces><NetworkInterface {network}/></Interfaces>{multicast}</General>"
    return f'<CycloneDDS><Domain Id="any">{general}{more}</Domain></CycloneDDS>'


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


class _Received:
    """CDR of a received sample."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


def _sample(type_: str, data: bytes) -> Any:
    kind = _kind(type_)
    sample = kind.__new__(kind)
    sample.cdr = data
    return sample


@cache
def _kind(type_: str) -> Any:
    """DDS's class of a ROS type, whose samples are written and taken as CDR, without conversion."""
    kind = _struct(type_)
    kind.serialize = lambda self, *args, **how: self.cdr
    kind.deserialize = classmethod(lambda cls, data, *args, **how: _Received(bytes(data)))
    kind.deserialize_key = kind.deserialize
    return kind


@cache
def _struct(type_: str) -> Any:
    idl, types = needed("cyclonedds.idl"), needed("cyclonedds.idl.types")
    package, kind, name = type_.split("/")
    fields = {name: _field(definition, types) for name, definition in Messages(is_ros1=False).types.fielddefs[type_][1]}
    # As ROS 2 does, since IDL has no empty structures.
    if name.endswith(("_Request", "_Response")):
        fields = {"client": types.uint64, "number": types.int64, **fields}
    fields = fields or {"structure_needs_at_least_one_member": types.uint8}
    return idl.make_idl_struct(f"{name}_", f"{package}.{kind}.dds_.{name}_", fields)


_BASES = {"string": "str", "bool": "bool", "byte": "byte", "char": "uint8"}


def _field(definition: Any, types: Any) -> Any:
    """DDS's type of a field, by rosbags' description: its kind, and what it is of."""
    kind, inner = definition[0].name, definition[1]
    if kind == "BASE":
        name = _BASES.get(inner[0], inner[0])
        if name == "str" and inner[1]:
            return types.bounded_str[inner[1]]
        return {"str": str, "bool": bool}.get(name) or getattr(types, name)
    if kind == "NAME":
        return _struct(inner)
    of, size = _field(inner[0], types), inner[1]
    return types.array[of, size] if kind == "ARRAY" else types.sequence[of]
