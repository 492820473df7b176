"""Which topics of a bag are camera, wheels, gyroscope and truth: by type, by frame, by name, or as the user says."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from wheelsight.errors import ConfigError, RecordingError
from wheelsight.recordings.rosbag.definitions import TF
from wheelsight.recordings.rosbag.images import is_depth
from wheelsight.recordings.rosbag.storage import COMPRESSED, IMAGE, OpenBag, Topic, TransformTopic
from wheelsight.recordings.rosbag.wheel_topics import (
    JOINTS,
    ODOMETRY,
    WheelSource,
    chosen_source,
    counted_transform,
    is_fused,
    sideways,
    sources_in,
    unread_topics,
)
from wheelsight.recordings.rosbag.wheels import Joints

INFO, IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Imu"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TEXT = "std_msgs/msg/String"
# Text of a calibration.yaml, which wheelsight's own bags carry; an Odometry beside it is its estimate.
CALIBRATION = "/wheelsight/calibration"
NONE = "none"
_TYPES = {
    "color": (IMAGE, COMPRESSED),
    "depth": (IMAGE, COMPRESSED),
    "color_info": (INFO,),
    "depth_info": (INFO,),
    "gyro": (IMU,),
    "truth": (POSE, POSE_COVARIANCE, TRANSFORM, ODOMETRY, *TF),
}
ROLES = ("color", "depth", "color_info", "depth_info", "wheels", "gyro", "truth")
_CHOICE = re.compile(r"(?P<role>[a-z_]+)=(?P<topic>[^:,\s]+)(?:,(?P<right>[^:,\s]+))?(?::(?P<sides>\S+))?")
_REGISTERED = re.compile(r"aligned|registered", re.IGNORECASE)
_TRANSPORT = re.compile(r"/(?:compressed|compressedDepth|theora|ffmpeg)$")
# Of several, colour before grey.
_COLOR_WORDS = (re.compile(r"colou?r|rgb", re.IGNORECASE), re.compile(r"image", re.IGNORECASE))
_NO_COLOR = re.compile(r"/ir\b|infra|depth|disparity|confidence|mask|debug|label", re.IGNORECASE)
# Of each is read; a robot with many cameras has some twenty.
_MOST_IMAGES = 200


@dataclass(frozen=True, slots=True)
class ImageTopic:
    """What the first message of a topic of images tells of all."""

    name: str
    frame: str
    encoding: str
    is_depth: bool

    @property
    def is_rectified(self) -> bool:
        """Whether its name says that lens distortion was taken out."""
        return "rect" in _base(self.name).rpartition("/")[2]

    @property
    def says_registered(self) -> bool:
        """Whether its name says that its pixels are those of the colour image."""
        return bool(_REGISTERED.search(self.name))


@dataclass(frozen=True, slots=True)
class Choices:
    """What a user says of topics. Raises ConfigError where the text is no choice.

    Attributes:
        topics: by role; NONE to leave one out.
        right: the topic of the right wheel, where each wheel has its own.
        sides: names of joints or fields, or places in an array, of the left and the right wheels; frames of tf, parent
            and child, for wheels.
        truth_frames: likewise for the truth.
    """

    topics: Mapping[str, str] = field(default_factory=dict)
    right: str | None = None
    sides: Joints | None = None
    truth_frames: Joints | None = None

    @classmethod
    def of(cls, texts: Sequence[str]) -> Choices:
        """Of "color=/camera/rgb/image_raw", or "wheels=/joint_states:left_joint,right_joint"."""
        topics: dict[str, str] = {}
        right, sides, truth_frames = None, None, None
        for text in texts:
            match = _CHOICE.fullmatch(text)
            if match is None or match["role"] not in ROLES or (match["right"] and match["role"] != "wheels"):
                problem = f"--topic {text}: ROLE=TOPIC is expected, with one of {', '.join(ROLES)}"
                raise ConfigError(problem, fix="such as --topic depth=/camera/depth/image_raw")
            topics[match["role"]] = match["topic"]
            if match["role"] == "wheels":
                right = match["right"]
            if match["sides"]:
                named = _sides(text, match["role"], match["sides"])
                sides, truth_frames = (named, truth_frames) if match["role"] == "wheels" else (sides, named)
        return cls(topics, right, sides, truth_frames)


@dataclass(frozen=True, slots=True)
class Roles:
    """The topics that are used, each None where there is none, and what is to be said about the choice.

    `transforms` are topics of their own in the bag; `faults`, also in `warnings`, are what makes wheels' poses wrong.
    """

    color: ImageTopic | None = None
    depth: ImageTopic | None = None
    color_info: str | None = None
    depth_info: str | None = None
    wheels: Topic | None = None
    source: WheelSource | None = None
    gyro: str | None = None
    truth: str | None = None
    transforms: tuple[TransformTopic, ...] = ()
    warnings: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def joints(self) -> Joints | None:
        """Those of the wheels, where they are joints."""
        return self.source.sides if self.source is not None and self.source.topic.type == JOINTS else None

    @property
    def needs_sizes(self) -> bool:
        """Whether the wheels are told of by how far they turn."""
        return self.source is not None and self.source.needs_sizes

    @property
    def used(self) -> dict[str, str]:
        """Names by role."""
        named = {"color": self.color, "depth": self.depth, "wheels": self.wheels}
        plain = {"color_info": self.color_info, "depth_info": self.depth_info, "gyro": self.gyro, "truth": self.truth}
        plain["right wheel"] = None if self.source is None else self.source.right
        names = {role: topic.name for role, topic in named.items() if topic is not None}
        return names | {role: name for role, name in plain.items() if name is not None}


def roles_of(bag: OpenBag, choices: Choices, knows_wheels: bool = False) -> Roles:
    """Who is who in a bag. Of topics of images and joints the first message is read.

    Args:
        bag: is read; transforms of tf that are used become topics of their own in it.
        choices: of the user.
        knows_wheels: whether a calibration is there that has the wheels' sizes.

    Raises:
        ConfigError: a topic that was chosen is not there, is empty, or of another type.
        RecordingError: a first message is damaged.
    """
    chosen = _chosen(bag, choices)
    filled = [topic for topic in bag.topics if topic.count]
    warnings: list[str] = []
    color, depth = _cameras(bag, filled, chosen, warnings)
    infos = [topic.name for topic in filled if topic.type == INFO]
    frames = {name: bag.header(bag.first(name)[0]).frame for name in infos}
    color_info = None if color is None else chosen.get("color_info") or _info_of(color, frames)
    # Registered depth has the colour camera's pixels.
    own_depth = None if depth is None or depth.says_registered else depth
    depth_info = None if own_depth is None else chosen.get("depth_info") or _info_of(own_depth, frames)
    truth = _truth(bag, chosen, choices)
    faults: list[str] = []
    source = _wheels(bag, filled, color is not None, choices, knows_wheels, truth, warnings, faults)
    gyro = _gyro(filled, chosen, warnings)
    if source is not None and gyro is not None and "gyro" not in chosen and is_fused(source):
        warnings.append(f"{gyro} is left out: {source.topic.name} has it already, it seems: see --topic gyro=….")
        gyro = None
    transforms = tuple(one for one in (source and source.transform, truth) if isinstance(one, TransformTopic))
    bag.add_transforms(transforms)
    wheels = None if source is None else source.topic
    name = truth.name if isinstance(truth, TransformTopic) else truth
    return Roles(
        color, depth, color_info, depth_info, wheels, source, gyro, name, transforms, (*warnings, *faults), (*faults,)
    )


def _sides(text: str, role: str, names: str) -> Joints:
    sides = tuple(tuple(side.split("+")) for side in names.split(","))
    if role not in ("wheels", "truth") or len(sides) != 2 or not all(name for side in sides for name in side):
        fix = (
            "wheels=/joint_states:left,right, or of four front_left+rear_left,front_right+rear_right; "
            "wheels=/tf:odom,base_link or truth=/tf:world,marker of tf"
        )
        raise ConfigError(f"--topic {text}: joints of a left and a right side are expected", fix=fix)
    return Joints(*sides)


def _truth(bag: OpenBag, chosen: Mapping[str, str], choices: Choices) -> TransformTopic | str | None:
    """The topic of true poses, which only a user can know of. Raises ConfigError."""
    name = chosen.get("truth")
    if name is None or name == NONE:
        return None
    topic = next(topic for topic in bag.topics if topic.name == name)
    if topic.type not in TF:
        return name
    if choices.truth_frames is None:
        fix = f"say which: --topic truth={name}:PARENT,CHILD, such as truth={name}:world,marker"
        raise ConfigError(f"--topic truth={name}: tf has many transforms", fix=fix)
    (parent, *_), (child, *_) = choices.truth_frames.left, choices.truth_frames.right
    return counted_transform(bag, topic, parent.lstrip("/"), child.lstrip("/"))


def _chosen(bag: OpenBag, choices: Choices) -> dict[str, str]:
    known = {topic.name: topic for topic in bag.topics}
    for role, name in choices.topics.items():
        if name == NONE or role == "wheels":
            continue
        of_type = ", ".join(topic.name for topic in bag.topics if topic.type in _TYPES[role] and topic.count)
        fix = f"there are: {of_type}" if of_type else f"the bag has none of {' or '.join(_TYPES[role])}"
        if name not in known or not known[name].count:
            raise ConfigError(f"--topic {role}={name}: {bag.path.name} has no messages of it", fix=fix)
        if known[name].type not in _TYPES[role]:
            raise ConfigError(f"--topic {role}={name} is of {known[name].type}", fix=fix)
    return dict(choices.topics)


def _cameras(
    bag: OpenBag, filled: Sequence[Topic], chosen: Mapping[str, str], warnings: list[str]
) -> tuple[ImageTopic | None, ImageTopic | None]:
    topics = [topic for topic in filled if topic.type in (IMAGE, COMPRESSED)]
    if len(topics) > _MOST_IMAGES:
        warnings.append(f"Of {len(topics)} topics of images, the first {_MOST_IMAGES} by name are looked at.")
        topics = [topic for topic in topics if topic.name in chosen.values()] + topics[:_MOST_IMAGES]
    images = [_image(bag, topic) for topic in topics]
    by_name = {image.name: image for image in images}
    if chosen.get("color") == NONE or chosen.get("depth") == NONE:
        return None, None
    colors = [image for image in images if not image.is_depth and not _NO_COLOR.search(image.name)]
    depths = [image for image in images if image.is_depth]
    if "color" in chosen:
        colors = [by_name[chosen["color"]]]
    if "depth" in chosen:
        depths = [by_name[chosen["depth"]]]
    both = [(color, depth) for color in colors for depth in depths if color is not depth]
    pairs = sorted((_unlikely(color, depth), color.name, depth.name) for color, depth in both)
    if not pairs:
        warnings += _half_a_camera(colors, depths)
        return None, None
    (best, color, depth), others = pairs[0], pairs[1:]
    rivals = [f"{c} with {d}" for unlikely, c, d in others if unlikely == best and _base(d) != _base(depth)]
    if rivals:
        taken = f"{color} with {depth} is taken, by its name alone"
        warnings.append(f"There are several cameras: {taken}, not {rivals[0]}. Choose by --topic color=… and depth=….")
    return by_name[color], by_name[depth]


def _image(bag: OpenBag, topic: Topic) -> ImageTopic:
    message = bag.first(topic.name)[0]
    decoded = bag.decode(message)
    encoding = str(decoded.format if topic.type == COMPRESSED else decoded.encoding)
    frame = str(decoded.header.frame_id).lstrip("/")
    return ImageTopic(topic.name, frame, encoding, is_depth(encoding, topic.name))


def _unlikely(color: ImageTopic, depth: ImageTopic) -> tuple[int, ...]:
    """How little two topics look like one camera's colour and depth; the least is taken."""
    parts = [_base(image.name).split("/") for image in (color, depth)]
    shared = next((i for i, (a, b) in enumerate(zip(*parts, strict=False)) if a != b), min(map(len, parts)))
    is_registered = color.frame == depth.frame or depth.says_registered
    by_word = next((i for i, word in enumerate(_COLOR_WORDS) if word.search(color.name)), len(_COLOR_WORDS))
    is_packed = sum(bool(_TRANSPORT.search(image.name)) for image in (color, depth))
    return (-shared if shared > 1 else 0, not is_registered, by_word, is_packed, color.is_rectified, depth.is_rectified)


def _base(name: str) -> str:
    """Name of the topic that a compressed one is of."""
    return _TRANSPORT.sub("", name)


def _half_a_camera(colors: Sequence[ImageTopic], depths: Sequence[ImageTopic]) -> list[str]:
    """What to say of images that are not used, since they are of one kind alone."""
    names = ", ".join(image.name for image in (*colors, *depths))
    if not names:
        return []
    return [f"Not used, for want of {'depth' if colors else 'colour'} images that go with them: {names}."]


def _info_of(image: ImageTopic, frames: Mapping[str, str]) -> str | None:
    """The CameraInfo beside an image, else the only one of its frame, else the only one there is."""
    folder = _base(image.name).rpartition("/")[0]
    # The RealSense SDK has …/image/data and …/info/camera_info.
    for beside in (f"{folder}/camera_info", f"{folder.rpartition('/')[0]}/info/camera_info"):
        if beside in frames:
            return beside
    alike = [name for name, frame in frames.items() if frame == image.frame and frame]
    if len(alike) == 1:
        return alike[0]
    return next(iter(frames)) if len(frames) == 1 else None


def _wheels(
    bag: OpenBag,
    filled: Sequence[Topic],
    has_camera: bool,
    choices: Choices,
    knows_wheels: bool,
    truth: TransformTopic | str | None,
    warnings: list[str],
    faults: list[str],
) -> WheelSource | None:
    """What tells of the wheels: raw readings before a filter's output; what is not taken is said, and why."""
    name = choices.topics.get("wheels")
    if name == NONE:
        return None
    if name is not None:
        chosen = chosen_source(bag, name, choices.right, choices.sides)
        told = sideways(bag, chosen)
        faults += [] if told is None else [f"{name} goes sideways: {told}; the way is wrong by as much."]
        return chosen
    own = any(topic.name == CALIBRATION for topic in filled)
    # In a bag of our own, poses and transforms are our estimate, by the other sensors.
    is_estimated = own and (has_camera or any(topic.type == JOINTS for topic in filled))
    left_out = {truth.of if isinstance(truth, TransformTopic) else truth}
    found = sources_in(bag, [topic for topic in filled if topic.name not in left_out], choices.sides, is_estimated)
    usable = [source for source in found if knows_wheels or not source.needs_sizes]
    if not usable and not has_camera:
        usable = found
    taken = usable[0] if usable else None
    told = None if taken is None else sideways(bag, taken)
    if taken is not None and told is not None:
        if not has_camera:
            faults.append(f"{taken.topic.name} goes sideways: {told}; the way is wrong by as much, no camera leads.")
        else:
            fix = f"the camera leads (--topic wheels={taken.topic.name} takes them all the same)"
            warnings.append(f"{taken.topic.name} is left out: {told}; {fix}.")
            found, taken = [source for source in found if source is not taken], None
    if taken is not None:
        warnings += [f"{taken.topic.name} is taken for the wheels' odometry, {taken.doubt}."] if taken.doubt else []
    others = [source for source in found if source is not taken]
    if taken is not None and others:
        names = ", ".join(f"{source.topic.name} ({source.why_not(knows_wheels)})" for source in others)
        warnings.append(f"{taken.topic.name} is taken for the wheels, not {names}: see --topic wheels=….")
    elif others:
        names = ", ".join(f"{source.topic.name} ({source.why_not(knows_wheels)})" for source in others)
        warnings.append(f"Wheels are not used: {names}.")
    warnings += unread_topics(bag, filled, found) if taken is None else []
    return taken


def _gyro(filled: Sequence[Topic], chosen: Mapping[str, str], warnings: list[str]) -> str | None:
    if "gyro" in chosen:
        return None if chosen["gyro"] == NONE else chosen["gyro"]
    found = [topic.name for topic in filled if topic.type == IMU]
    if len(found) > 1:
        warnings.append(f"{found[0]} is taken for the gyroscope, not {', '.join(found[1:])}: see --topic gyro=….")
    return found[0] if found else None


def lacks(roles: Roles, bag: OpenBag, path: Path) -> RecordingError:
    """What to say of a bag with neither camera nor wheels."""
    types = {topic.type for topic in bag.topics if topic.count}
    none = ["counts or speeds of wheels", "odom → base_link in tf", "Odometry", "JointState of wheels"]
    missing = ["no depth images with colour", *(f"no {what}" for what in none)]
    others = "".join(f" {warning}" for warning in roles.warnings)
    shown = ", ".join(f"{topic.name} ({topic.type.rpartition('/')[2]}, {topic.count:,})" for topic in bag.topics)
    problem = f"holds nothing to localize by: {', '.join(missing)}.{others} Its topics: {shown or 'none'}"
    if not types:
        return RecordingError("holds no messages", path=path, fix="record again")
    return RecordingError(problem, path=path, fix="record colour, depth, camera_info, tf_static and odom")
