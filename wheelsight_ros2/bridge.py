"""Bridge: passes a drive or a run on to peers (Foxglove, ROS 2), and what they ask to the session that drives.

`open_bridge` makes one of the options of a command. A peer that fails is left out; the robot goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Protocol

from wheelsight.app.page import Session, Watch, token_of
from wheelsight.app.run.run_record import FrameRecord
from wheelsight.app.run.track import RunTrack, Watcher
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import Event
from wheelsight.navigation import Feedback, NavigationSettings, Navigator, Transition
from wheelsight_export.bag_writing import Messages, Sent, nanoseconds
from wheelsight_export.topics import TOPICS, Flow, Topic
from wheelsight_ros2.actions import NavigateServer
from wheelsight_ros2.inputs import Inputs
from wheelsight_ros2.live_topics import LiveTopics, main_track

RECEIVED_BYTES = 65_536  # the most of a message that a peer sends; a pose takes 400


class Peer(Protocol):
    """A way to other programs. Its `close` is called once."""

    @property
    def name(self) -> str:
        """What messages call it."""

    def wants(self, topic: str) -> bool:
        """Whether any program takes a topic now."""

    def send(self, topic: Topic, data: bytes, stamp_ns: int) -> None:
        """Send a message in CDR. It does not wait for those that take it."""

    def close(self) -> None:
        """End all connections."""


OnMessage = Callable[[str, str, bytes], None]
"""Called by a peer with topic, type and CDR of a message that it received, in its own thread."""


class Bridge:
    """A listener to drives (`Watch`) and to runs (`Watcher`).

    Args:
        peers: the opened peers.
        topics: makes messages.
        inputs: takes messages of the peers.
        on_problem: called with one line about a peer that fails.
        action: goals of other programs; None for none.
    """

    def __init__(
        self,
        peers: Sequence[Peer],
        topics: LiveTopics,
        inputs: Inputs,
        on_problem: Callable[[str], None],
        action: NavigateServer | None = None,
    ) -> None:
        self._peers, self._topics, self.inputs, self._on_problem = list(peers), topics, inputs, on_problem
        self._action = action
        self._stamp_s = 0.0

    @property
    def stamp_s(self) -> float:
        """The newest stamp that was sent, seconds."""
        return self._stamp_s

    def lead(self, session: Session) -> None:
        """Let peers lead a session from now on."""
        self.inputs.lead(session)

    def on_events(self, events: Sequence[Event]) -> None:
        """See `Watch`."""
        self._send(lambda: self._topics.of_events(events))

    def note(self, transition: Transition) -> None:
        """See `Watch`: the state follows with the period."""
        self._act(lambda action: action.note(transition))

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """See `Watch`."""
        self._stamp_s = feedback.stamp_s
        words = {"refused": self.inputs.refused, "counts": dict(self.inputs.counts)}
        self._send(lambda: self._topics.of_drive(feedback, navigator, words))
        self._act(lambda action: action.step(feedback, navigator))

    def run_step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> None:
        """An answered event of a run."""
        self._stamp_s = max(self._stamp_s, event.stamp_s)
        self._send(lambda: self._topics.of_run(event, answers, tracks))

    def run_end(self, tracks: Sequence[RunTrack]) -> None:
        """The end of a run: the finished map, and its loops."""
        self._send(lambda: self._topics.points(self._stamp_s, main_track(tracks), is_last=True))

    def _act(self, do: Callable[[NavigateServer], None]) -> None:
        """Let the action follow the drive; its errors leave it out, too."""
        if self._action is None:
            return
        try:
            do(self._action)
        except Exception as error:
            self._action = None
            self._on_problem(f"no goals of actions are taken any more: {type(error).__name__}: {error}")

    def _send(self, made: Callable[[], Iterable[Sent]]) -> None:
        """Send messages to all peers. Nothing of an interface stops a robot: errors are reported, and leave it out."""
        if not self._peers:
            return
        try:
            for sent in made():
                topic = TOPICS[sent.topic]
                # Latched ones are kept for programs that come later.
                if topic.flow is not Flow.LATCHED and not any(peer.wants(topic.name) for peer in self._peers):
                    continue
                data = self._topics.make.bytes_of(sent.message)
                for peer in tuple(self._peers):
                    self._send_to(peer, topic, data, nanoseconds(sent.stamp_s))
        except Exception as error:
            self._peers.clear()
            self._on_problem(f"nothing is sent to other programs any more: {type(error).__name__}: {error}")

    def _send_to(self, peer: Peer, topic: Topic, data: bytes, stamp_ns: int) -> None:
        try:
            peer.send(topic, data, stamp_ns)
        except Exception as error:
            self._peers.remove(peer)
            self._on_problem(f"{peer.name} is left out: {type(error).__name__}: {error}")


class RunBridge:
    """A bridge as the `Watcher` of a run, beside another one or none."""

    def __init__(self, bridge: Bridge, other: Watcher | None) -> None:
        self._bridge, self._other = bridge, other

    def step(self, event: Event, answers: Mapping[str, FrameRecord], tracks: Sequence[RunTrack]) -> None:
        """See `Watcher`."""
        if self._other is not None:
            self._other.step(event, answers, tracks)
        self._bridge.run_step(event, answers, tracks)

    def finish(self, tracks: Sequence[RunTrack]) -> None:
        """See `Watcher`."""
        if self._other is not None:
            self._other.finish(tracks)
        self._bridge.run_end(tracks)


class Watches:
    """Several listeners to drives as one."""

    def __init__(self, *watches: Watch) -> None:
        self._watches = watches

    def on_events(self, events: Sequence[Event]) -> None:
        """See `Watch`."""
        for watch in self._watches:
            watch.on_events(events)

    def note(self, transition: Transition) -> None:
        """See `Watch`."""
        for watch in self._watches:
            watch.note(transition)

    def step(self, feedback: Feedback, navigator: Navigator) -> None:
        """See `Watch`."""
        for watch in self._watches:
            watch.step(feedback, navigator)


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Options of a command.

    Attributes:
        foxglove: PORT or HOST:PORT of Foxglove's server; None for none.
        token: required by it; None for a new one.
        ros2: "dds" or "zenoh"; None for none.
        domain: of ROS 2.
        namespace: before all topics of ROS 2, such as "/chair".
        interface: network interface or address of DDS, or zenoh's router; None for this computer alone.
    """

    foxglove: str | None = None
    token: str | None = None
    ros2: str | None = None
    domain: int = 0
    namespace: str = ""
    interface: str | None = None

    @property
    def is_any(self) -> bool:
        """Whether any interface is asked for."""
        return self.foxglove is not None or self.ros2 is not None

    def check(self) -> None:
        """Raise ConfigError for invalid options and for missing libraries."""
        from wheelsight.core.runtime import needed
        from wheelsight_ros2.foxglove import address_of

        needed("rosbags.typesys")
        if self.foxglove is not None:
            needed("websockets")
            address_of(self.foxglove)
            token_of("--link-token", self.token)
        elif self.token is not None:
            raise ConfigError("--link-token is of Foxglove's server", fix="--foxglove PORT, or leave it out")
        if self.ros2 is None:
            if self.interface is not None or self.namespace or self.domain:
                raise ConfigError("--domain, --namespace and --interface are of ROS 2", fix="--ros2 dds, or leave out")
            return
        if self.ros2 not in ("dds", "zenoh"):
            raise ConfigError(f"--ros2 is {self.ros2!r}", fix="dds or zenoh")
        needed("cyclonedds" if self.ros2 == "dds" else "zenoh")
        from wheelsight_ros2.dds import check_names
        from wheelsight_ros2.zenoh import endpoint_of

        check_names(self.domain, self.namespace)
        if self.ros2 == "zenoh":
            endpoint_of(self.interface)


@contextmanager
def open_bridge(
    settings: LinkSettings,
    calibration: Calibration,
    *,
    is_simulated: bool,
    robot_s: Callable[[], float],
    navigation: NavigationSettings | None = None,
    on_problem: Callable[[str], None],
    on_note: Callable[[str], None],
) -> Iterator[Bridge]:
    """A bridge for the block.

    Args:
        settings: checked ones.
        calibration: of the robot.
        is_simulated: whether stamps are simulated.
        robot_s: the time of stamps now.
        navigation: settings of the robot.
        on_problem: called from several threads with one line about each refused message and failing peer.
        on_note: called with one line about each opened interface.

    Raises:
        ConfigError: an address or interface cannot be used.
    """
    make = Messages(is_ros1=False)
    inputs = Inputs(robot_s, on_problem)

    def receive(topic: str, type_: str, data: bytes) -> None:
        if len(data) > RECEIVED_BYTES:
            inputs.refuse(topic, f"a message of {len(data):,} bytes")
            return
        try:
            message = make.types.deserialize_cdr(data, type_)
        except Exception as error:  # rosbags raises many kinds for bytes that are no message
            inputs.refuse(topic, f"is no {type_} ({type(error).__name__})")
            return
        inputs.receive(topic, message)

    peers: list[Peer] = []
    action: NavigateServer | None = None

    def wants(topic: str) -> bool:
        return any(peer.wants(topic) for peer in peers)

    with ExitStack() as opened:
        if settings.foxglove is not None:
            from wheelsight_ros2.foxglove import FoxgloveServer

            server = FoxgloveServer(settings.foxglove, settings.token, inputs, receive, on_problem)
            opened.callback(server.close)
            peers.append(server)
            on_note(f"Foxglove: {server.address}")
            if not server.is_loopback:
                on_problem("what Foxglove sends and receives is not encrypted: on a network that you trust alone")
        if settings.ros2 is not None:
            from wheelsight_ros2.dds import DdsPeer
            from wheelsight_ros2.zenoh import ZenohPeer

            kind = DdsPeer if settings.ros2 == "dds" else ZenohPeer
            node = kind(settings.domain, settings.namespace, settings.interface, receive)
            opened.callback(node.close)
            peers.append(node)
            if isinstance(node, DdsPeer):
                action = NavigateServer(make, inputs, robot_s)
                opened.callback(action.close)
                node.serve(action)
            on_note(f"ROS 2: {node.name}")
            if settings.interface is not None:
                on_problem("ROS 2 asks for no token: each computer of that network can move the robot")
        topics = LiveTopics(calibration, wants, is_simulated=is_simulated, settings=navigation)
        yield Bridge(peers, topics, inputs, on_problem, action)
