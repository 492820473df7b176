"""ZenohPeer: topics of ROS 2 as rmw_zenoh speaks them, for computers without a wheel of Cyclone DDS.

Keys are `domain/topic/type/hash`, liveliness tokens `@ros2_lv/…`, and attachments a number, a time and a source, as
https://github.com/ros2/rmw_zenoh describes them (docs/design.md). Messages are the CDR of the bags' writer.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from wheelsight.core.errors import ConfigError
from wheelsight.core.runtime import needed
from wheelsight_export.bag_writing import Messages
from wheelsight_export.topics import TOPICS, Flow, Topic
from wheelsight_ros2.dds import DEPTH, NODE, TAKE_S, check_names
from wheelsight_ros2.inputs import INPUTS

# Where ROS 2's router waits: `ros2 run rmw_zenoh_cpp rmw_zenohd`.
_ROUTER = "tcp/127.0.0.1:7447"
_ENDS_S, _GID_BYTES = 5.0, 16
# rmw's numbers of what differs from rmw_zenoh's own default: best effort, and transient local.
_BEST_EFFORT, _TRANSIENT_LOCAL = "2", "1"


class ZenohPeer:
    """A node with a publisher for each live topic and a subscription for each input; see `Peer`.

    Args:
        domain: of ROS 2.
        namespace: before all topics.
        router: its address, HOST, HOST:PORT or tcp/HOST:PORT; None for this computer's. It may begin later.
        on_cdr: called with topic, type and CDR of each input, from one thread.

    Raises:
        ConfigError: the address is none.
    """

    def __init__(
        self, domain: int, namespace: str, router: str | None, on_cdr: Callable[[str, str, bytes], None]
    ) -> None:
        check_names(domain, namespace)
        zenoh, extension = needed("zenoh"), needed("zenoh.ext")
        endpoint, self._on_cdr, self._serialize = endpoint_of(router), on_cdr, extension.z_serialize
        self._int64 = extension.Int64
        self.name = f"zenoh, domain {domain}, router {endpoint}"
        config = zenoh.Config()
        settings = {
            "mode": "peer",
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": -1,  # the router may begin later
            "connect/exit_on_failure": False,
            "listen/endpoints": ["tcp/127.0.0.1:0"],
            "scouting/multicast/enabled": False,
            "timestamping/enabled": True,  # a cache needs it
        }
        try:
            for name, value in settings.items():
                config.insert_json5(name, json.dumps(value))
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            fix = "the address of a router, such as 192.168.1.20, or leave out --interface"
            raise ConfigError(f"zenoh cannot use {endpoint}: {error}", fix=fix) from error
        types = Messages(is_ros1=False).types
        about = f"@ros2_lv/{domain}/{self._session.zid()}/0"
        self._tokens = [self._session.liveliness().declare_token(f"{about}/0/NN/%/%/{NODE}")]
        self._publishers: dict[str, tuple[Any, bytes]] = {}
        self._numbers: dict[str, int] = {}
        self._inputs: list[tuple[Topic, Any]] = []
        for number, topic in enumerate(TOPICS.values(), 1):
            package, _, name = topic.type.partition("/msg/")
            type_ = f"{package}::msg::dds_::{name}_/{types.hash_rihs01(topic.type)}"
            path = f"{namespace}{topic.name}"
            key = f"{domain}{path}/{type_}"
            kind = "MS" if topic.name in INPUTS else "MP"
            if kind == "MS":
                ring = needed("zenoh.handlers").RingChannel(1)
                self._inputs.append((topic, self._session.declare_subscriber(key, ring)))
            elif topic.is_live:
                self._publishers[topic.name] = self._publisher(topic, key), secrets.token_bytes(_GID_BYTES)
            else:
                continue
            token = f"{about}/{number}/{kind}/%/%/{NODE}/{path.replace('/', '%')}/{type_}/{quality_of(topic.flow)}"
            self._tokens.append(self._session.liveliness().declare_token(token))
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._receive, name="wheelsight-zenoh", daemon=True)
        self._thread.start()

    def wants(self, topic: str) -> bool:
        """See `Peer`."""
        return topic in self._publishers and bool(self._publishers[topic][0].matching_status.matching)

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """See `Peer`. A message is dropped where a program does not take the earlier ones."""
        if topic.name not in self._publishers:
            return
        publisher, source = self._publishers[topic.name]
        number = self._numbers[topic.name] = self._numbers.get(topic.name, 0) + 1
        about = (number, time.time_ns())
        head = b"".join(bytes(self._serialize(self._int64(value))) for value in about)
        publisher.put(data, attachment=head + bytes(self._serialize(source)))

    def close(self) -> None:
        """See `Peer`."""
        self._is_over.set()
        self._thread.join(_ENDS_S)
        self._session.close()

    def _publisher(self, topic: Topic, key: str) -> Any:
        zenoh, extension = needed("zenoh"), needed("zenoh.ext")
        is_sensor = topic.flow is Flow.SENSOR
        how: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.DROP}
        how["reliability"] = zenoh.Reliability.BEST_EFFORT if is_sensor else zenoh.Reliability.RELIABLE
        if topic.flow is not Flow.LATCHED:
            return self._session.declare_publisher(key, **how)
        cache = extension.CacheConfig(max_samples=1)
        return extension.declare_advanced_publisher(self._session, key, cache=cache, publisher_detection=True, **how)

    def _receive(self) -> None:
        """The thread: take inputs, of each topic the newest."""
        while not self._is_over.wait(TAKE_S):
            for topic, subscriber in self._inputs:
                with suppress(Exception):  # the session has ended
                    sample = subscriber.try_recv()
                    if sample is not None:
                        self._on_cdr(topic.name, topic.type, bytes(sample.payload))


def endpoint_of(router: str | None) -> str:
    """Zenoh's address of a router: HOST, HOST:PORT or tcp/HOST:PORT. Raises ConfigError."""
    if router is None:
        return _ROUTER
    host, _, port = router.removeprefix("tcp/").rpartition(":")
    if not host:
        host, port = port, "7447"
    if "/" in host or not host or not port.isdecimal() or int(port) > 65535:
        raise ConfigError(f"--interface is {router!r}", fix="of zenoh the router's address, such as 192.168.1.20:7447")
    return f"tcp/{host}:{port}"


def quality_of(flow: Flow) -> str:
    """Quality of service in a token: what differs from reliable, volatile and 42 messages."""
    reliability = _BEST_EFFORT if flow in (Flow.SENSOR, Flow.COMMAND) else ""
    durability = _TRANSIENT_LOCAL if flow is Flow.LATCHED else ""
    return f"{reliability}:{durability}:,{DEPTH if flow is Flow.RELIABLE else 1}:,:,:,,"
