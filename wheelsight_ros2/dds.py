"""DdsPeer: topics of ROS 2 over DDS, by Cyclone DDS, without a ROS installation.

Names and types follow https://design.ros2.org/articles/topic_and_service_names.html: `rt/odom` is /odom, and
`nav_msgs::msg::dds_::Odometry_` is nav_msgs/msg/Odometry. Messages are the CDR of the bags' writer.
"""

from __future__ import annotations

import ipaddress
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any
from xml.sax.saxutils import quoteattr

from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import needed
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import TOPICS, Flow, Topic

# Messages of a topic are taken at most so often: of a flood the newest.
TAKE_S = 0.01
_WAIT_S, _ENDS_S = 0.2, 5.0
# How long a writer may wait for a reader that does not acknowledge: the robot's thread must not.
_BLOCKING_S = 0.001
DEPTH, _MOST_DOMAIN = 10, 232
_MS = 1_000_000
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
    """A participant with a writer for each live topic and a reader for each input; see `Peer`.

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
        where = "this computer alone" if interface is None else interface
        self.name = f"DDS, domain {domain}, {where}"
        try:
            self._domain = needed("cyclonedds.domain").Domain(domain, configuration(interface))
            self._participant = needed("cyclonedds.domain").DomainParticipant(domain)
        except self._dds.DDSException as error:
            fix = "a network of ip address, or leave out --interface"
            raise ConfigError(f"DDS cannot use {where}: {error}", fix=fix) from error
        self._writers: dict[str, Any] = {}
        self._readers: list[tuple[Topic, Any]] = []
        for topic in TOPICS.values():
            made = needed("cyclonedds.topic").Topic(
                self._participant, f"rt{namespace}{topic.name}", _kind(topic.type), qos=None
            )
            qos = self._qos(topic.flow)
            if topic.flow in (Flow.INPUT, Flow.COMMAND):
                reader = needed("cyclonedds.sub").DataReader(self._participant, made, qos=qos)
                self._readers.append((topic, reader))
            elif topic.is_live:
                self._writers[topic.name] = needed("cyclonedds.pub").DataWriter(self._participant, made, qos=qos)
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="wheelsight-dds", daemon=True)
        self._thread.start()

    def wants(self, topic: str) -> bool:
        """See `Peer`."""
        return topic in self._writers and bool(self._writers[topic].get_matched_subscriptions())

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """See `Peer`. A message is dropped where a reader of a reliable topic does not acknowledge the earlier ones."""
        writer = self._writers.get(topic.name)
        if writer is None:
            return
        try:
            writer.write(_sample(topic.type, data))
        except self._dds.DDSException as error:
            if error.code != self._dds.DDSException.DDS_RETCODE_TIMEOUT:
                raise

    def close(self) -> None:
        """See `Peer`."""
        self._is_over.set()
        self._thread.join(_ENDS_S)
        self._readers.clear()
        self._writers.clear()
        # What nothing refers to is deleted; the participant with its topics at once.
        del self._participant, self._domain

    def _qos(self, flow: Flow) -> Any:
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
        return self._dds.Qos(reliability, durability, policy.History.KeepLast(depth), plain)

    def _receive(self) -> None:
        """The thread: take inputs, of each topic the newest."""
        core = self._dds
        waiting = core.WaitSet(self._participant)
        state = core.SampleState.NotRead | core.ViewState.Any | core.InstanceState.Alive
        for _, reader in self._readers:
            waiting.attach(core.ReadCondition(reader, state))
        while not self._is_over.is_set():
            with suppress(core.DDSException):
                if not waiting.wait(round(_WAIT_S * 1000 * _MS)):
                    continue
                for topic, reader in self._readers:
                    for sample in reader.take(1):
                        if isinstance(sample, _Received):
                            self._on_cdr(topic.name, topic.type, sample.data)
            time.sleep(TAKE_S)


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
    package, _, name = type_.rpartition("/msg/")
    fields = {name: _field(definition, types) for name, definition in Messages(is_ros1=False).types.fielddefs[type_][1]}
    # As ROS 2 does, since IDL has no empty structures.
    fields = fields or {"structure_needs_at_least_one_member": types.uint8}
    return idl.make_idl_struct(f"{name}_", f"{package}.msg.dds_.{name}_", fields)


_BASES = {"string": "str", "bool": "bool", "byte": "byte", "char": "uint8"}


def _field(definition: Any, types: Any) -> Any:
    """DDS's type of a field, by rosbags' description: its kind, and what it is of."""
    kind, inner = definition[0].name, definition[1]
    if kind == "BASE":
        name = _BASES.get(inner[0], inner[0])
        return {"str": str, "bool": bool}.get(name) or getattr(types, name)
    if kind == "NAME":
        return _struct(inner)
    of, size = _field(inner[0], types), inner[1]
    return types.array[of, size] if kind == "ARRAY" else types.sequence[of]
