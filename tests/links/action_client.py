"""A client of NavigateToPose by Cyclone DDS alone, as rmw_cyclonedds makes one; its types are from ROS's definitions.

`python action_client.py DOMAIN [NAMESPACE]` reads commands as lines of JSON: "send", "cancel", "result" with an "id" of
one byte. It writes what it receives as lines of JSON.
"""

# mypy: ignore-errors
# Cyclone's metaclass takes the fields' types at run time, from annotations that mypy takes for wrong.

import json
import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import (
    array,
    bounded_str,
    float32,
    int8,
    int16,
    int32,
    int64,
    sequence,
    uint8,
    uint16,
    uint32,
    uint64,
)
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from dds_peer import LOOPBACK, Header, Point, Pose, PoseStamped, Quaternion, Time, plain, say


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32
    nanosec: uint32


@dataclass
class UUID(IdlStruct, typename="unique_identifier_msgs::msg::dds_::UUID_"):
    uuid: array[uint8, 16]


@dataclass
class Goal(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_Goal_"):
    pose: PoseStamped
    behavior_tree: str = ""


@dataclass
class Result(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_Result_"):
    error_code: uint16
    error_msg: str


@dataclass
class Feedback(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_Feedback_"):
    current_pose: PoseStamped
    navigation_time: Duration
    estimated_time_remaining: Duration
    number_of_recoveries: int16
    distance_remaining: float32


@dataclass
class FeedbackMessage(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_FeedbackMessage_"):
    goal_id: UUID
    feedback: Feedback


@dataclass
class GoalInfo(IdlStruct, typename="action_msgs::msg::dds_::GoalInfo_"):
    goal_id: UUID
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename="action_msgs::msg::dds_::GoalStatus_"):
    goal_info: GoalInfo
    status: int8


@dataclass
class GoalStatusArray(IdlStruct, typename="action_msgs::msg::dds_::GoalStatusArray_"):
    status_list: sequence[GoalStatus]


# Two numbers stand before requests and responses.
@dataclass
class SendRequest(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_"):
    client: uint64
    number: int64
    goal_id: UUID
    goal: Goal


@dataclass
class SendResponse(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_SendGoal_Response_"):
    client: uint64
    number: int64
    accepted: bool
    stamp: Time


@dataclass
class ResultRequest(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_GetResult_Request_"):
    client: uint64
    number: int64
    goal_id: UUID


@dataclass
class ResultResponse(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_GetResult_Response_"):
    client: uint64
    number: int64
    status: int8
    result: Result


@dataclass
class CancelRequest(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Request_"):
    client: uint64
    number: int64
    goal_info: GoalInfo


@dataclass
class CancelResponse(IdlStruct, typename="action_msgs::srv::dds_::CancelGoal_Response_"):
    client: uint64
    number: int64
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: bounded_str[256]
    node_name: bounded_str[256]
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


SERVICES = {
    "send": ("send_goal", SendRequest, SendResponse),
    "cancel": ("cancel_goal", CancelRequest, CancelResponse),
    "result": ("get_result", ResultRequest, ResultResponse),
}
RELIABLE, KEPT = Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal


def id_of(number: int) -> UUID:
    return UUID([number] * 16)


class Client:
    def __init__(self, domain: int, namespace: str) -> None:
        self.domain, self.participant = Domain(domain, LOOPBACK), DomainParticipant(domain)
        self.nodes, self.sent = None, 0
        self.ends, path = {}, f"{namespace}/navigate_to_pose/_action"
        for kind, (name, request, response) in SERVICES.items():
            about = Policy.Userdata(b"clientid=1.2.3.4.5.6.7.8.9.a.b.c.d.e.f.10;")
            qos = Qos(RELIABLE, Policy.History.KeepLast(10), about)
            asked = Topic(self.participant, f"rq{path}/{name}Request", request)
            answered = Topic(self.participant, f"rr{path}/{name}Reply", response)
            self.ends[kind] = (
                DataWriter(self.participant, asked, qos=qos),
                DataReader(self.participant, answered, qos=qos),
            )
        self.client = int.from_bytes(self.ends["send"][0].guid.bytes[:8], "little")
        self.topics = {
            name: DataReader(self.participant, Topic(self.participant, topic, kind), qos=Qos(*qos))
            for name, topic, kind, qos in (
                ("feedback", f"rt{path}/feedback", FeedbackMessage, (RELIABLE, Policy.History.KeepLast(10))),
                ("status", f"rt{path}/status", GoalStatusArray, (RELIABLE, KEPT)),
                ("nodes", "ros_discovery_info", ParticipantEntitiesInfo, (RELIABLE, KEPT)),
            )
        }
        threading.Thread(target=self.take, daemon=True).start()

    def do(self, said) -> None:
        """Once the server's both ends are matched, as `wait_for_server` waits for them."""
        if said["topic"] == "nodes":
            while self.nodes is None:
                time.sleep(0.01)
            ends = {"readers": self.seen(True), "writers": self.seen(False)}
            say(topic="nodes", message=plain(self.nodes) | ends)
            return
        writer, reader = self.ends[said["topic"]]
        while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
            time.sleep(0.01)
        self.sent += 1
        id_, kind = id_of(said["id"]), SERVICES[said["topic"]][1]
        if kind is SendRequest:
            place = Pose(Point(float(said["x"]), float(said["y"])), Quaternion(w=said.get("qw", 1.0)))
            goal = Goal(PoseStamped(Header(Time(0), said.get("frame", "map")), place))
            writer.write(SendRequest(self.client, self.sent, id_, goal))
        elif kind is CancelRequest:
            writer.write(CancelRequest(self.client, self.sent, GoalInfo(id_, Time(said.get("sec", 0)))))
        else:
            writer.write(ResultRequest(self.client, self.sent, id_))

    def take(self) -> None:
        readers = {**{kind: reader for kind, (_, reader) in self.ends.items()}, **self.topics}
        while True:
            for name, reader in readers.items():
                for sample in reader.take(10):
                    if isinstance(sample, IdlStruct) and getattr(sample, "client", self.client) == self.client:
                        if name == "nodes":
                            self.nodes = sample
                        else:
                            say(topic=name, message=plain(sample))
            time.sleep(0.005)

    def seen(self, is_reader: bool) -> list[list[int]]:
        """Numbers of the ends that this client has met."""
        found = []
        for writer, reader in self.ends.values():
            if is_reader:
                found += [writer.get_matched_subscription_data(one) for one in writer.get_matched_subscriptions()]
            else:
                found += [reader.get_matched_publication_data(one) for one in reader.get_matched_publications()]
        return [list(one.key.bytes) for one in found if one is not None]


if __name__ == "__main__":
    client = Client(int(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else "")
    say(topic="ready")
    for line in sys.stdin:
        client.do(json.loads(line))
