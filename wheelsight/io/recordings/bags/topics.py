"""`roles_of` assigns the topics of a bag to camera, wheels, gyroscope and truth: by type, frame, name, or choice of
the user.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from wheelsight.core.calibration_parts import HolonomicWheels
from wheelsight.core.errors import ConfigError, RecordingError
from wheelsight.io.recordings.bags.chunks import TF
from wheelsight.io.recordings.bags.images import is_depth
from wheelsight.io.recordings.bags.storage import COMPRESSED, IMAGE, OpenBag, Topic, TransformTopic
from wheelsight.io.recordings.bags.wheel_readings import Joints
from wheelsight.io.recordings.bags.wheel_topics import (
    JOINTS,
    ODOMETRY,
    WheelTopic,
    chosen_source,
    counted_transform,
    holonomic_source,
    is_fused,
    sideways,
    sources_in,
    unread_topics,
)

INFO, IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Imu"
POSE, POSE_COVARIANCE = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TEXT = "std_msgs/msg/String"
# Text of a calibration.yaml, in bags that wheelsight wrote. An Odometry beside it is wheelsight's estimate.
CALIBRATION = "/wheelsight/calibration"
# The pose by a holonomic base's own odometry, in bags that wheelsight wrote.
WHEEL_ODOMETRY = "/wheelsight/wheel_odometry"
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
# In order of preference: colour before grey.
_COLOR_WORDS = (re.compile(r"colou?r|rgb", re.IGNORECASE), re.compile(r"image", re.IGNORECASE))
_NO_COLOR = re.compile(r"/ir\b|infra|depth|disparity|confidence|mask|debug|label", re.IGNORECASE)
# One message of each image topic is read. A robot with many cameras has about twenty topics.
_MOST_IMAGES = 200


@dataclass(frozen=True, slots=True)
class ImageTopic:
    """A topic of images, as its first message describes it."""

    name: str
    frame: str
    encoding: str
    is_depth: bool

    @property
    def is_rectified(self) -> bool:
        """Whether its name says that lens distortion was removed."""
        return "rect" in _base(self.name).rpartition("/")[2]

    @property
    def says_registered(self) -> bool:
        """Whether its name says that it is registered to the colour image."""
        return bool(_REGISTERED.search(self.name))


@dataclass(frozen=True, slots=True)
class Choices:
    """The topics that the user chose.

    Attributes:
        topics: by role; NONE to leave a role out.
        right: the topic of the right wheel, where each wheel has its own.
        sides: names of joints or fields, or indices of an array, of the left and the right wheels; of tf, parent and
            child frame.
        truth_frames: parent and child frame of the truth.
        places: names of joints, or indices of an array, of three or four wheels of a holonomic base.
    """

    topics: Mapping[str, str] = field(default_factory=dict)
    right: str | None = None
    sides: Joints | None = None
    truth_frames: Joints | None = None
    places: tuple[str, ...] = ()

    @classmethod
    def of(cls, texts: Sequence[str]) -> Choices:
        """The choices of texts such as "color=/camera/rgb/image_raw" or "wheels=/joint_states:left_joint,right_joint".

        Raises ConfigError where a text is not valid.
        """
        topics: dict[str, str] = {}
        right, sides, truth_frames = None, None, None
        places: tuple[str, ...] = ()
        for text in texts:
            match = _CHOICE.fullmatch(text)
            if match is None or match["role"] not in ROLES or (match["right"] and match["role"] != "wheels"):
                problem = f"--topic {text}: ROLE=TOPIC is expected, with one of {', '.join(ROLES)}"
                raise ConfigError(problem, fix="such as --topic depth=/camera/depth/image_raw")
            topics[match["role"]] = match["topic"]
            if match["role"] == "wheels":
                right = match["right"]
            if match["role"] == "wheels" and match["sides"] and match["sides"].count(",") in (2, 3):
                places = tuple(match["sides"].split(","))
            elif match["sides"]:
                named = _sides(text, match["role"], match["sides"])
                sides, truth_frames = (named, truth_frames) if match["role"] == "wheels" else (sides, named)
        return cls(topics, right, sides, truth_frames, places)


def _sides(text: str, role: str, names: str) -> Joints:
    """The two sides of "left,right", each of one or several names. Raises ConfigError."""
    sides = tuple(tuple(side.split("+")) for side in names.split(","))
    if role not in ("wheels", "truth") or len(sides) != 2 or not all(name for side in sides for name in side):
        fix = (
            "wheels=/joint_states:left,right, or of four front_left+rear_left,front_right+rear_right; "
            "wheels=/tf:odom,base_link or truth=/tf:world,marker of tf"
        )
        raise ConfigError(f"--topic {text}: joints of a left and a right side are expected", fix=fix)
    return Joints(*sides)


@dataclass(frozen=True, slots=True)
class Roles:
    """The topic of each role, None where there is none, with warnings about the choice.

    Attributes:
        source: how the wheels' topic describes their motion.
        transforms: transforms of tf that are used; the bag serves them as topics.
        faults: those of the warnings that make poses by wheels wrong.
    """

    color: ImageTopic | None = None
    depth: ImageTopic | None = None
    color_info: str | None = None
    depth_info: str | None = None
    wheels: Topic | None = None
    source: WheelTopic | None = None
    gyro: str | None = None
    truth: str | None = None
    transforms: tuple[TransformTopic, ...] = ()
    warnings: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def joints(self) -> Joints | None:
        """The joints of the wheels, where their topic is of joint states."""
        return self.source.sides if self.source is not None and self.source.topic.type == JOINTS else None

    @property
    def needs_sizes(self) -> bool:
        """Whether the wheels' topic gives angles or counts, so that the wheels' sizes are needed."""
        return self.source is not None and self.source.needs_sizes

    @property
    def used(self) -> dict[str, str]:
        """Names of topics by role."""
        named = {"color": self.color, "depth": self.depth, "wheels": self.wheels}
        plain = {"color_info": self.color_info, "depth_info": self.depth_info, "gyro": self.gyro, "truth": self.truth}
        plain["right wheel"] = None if self.source is None else self.source.right
        names = {role: topic.name for role, topic in named.items() if topic is not None}
        return names | {role: name for role, name in plain.items() if name is not None}


def roles_of(
    bag: OpenBag, choices: Choices, knows_wheels: bool = False, holonomic: HolonomicWheels | None = None
) -> Roles:
    """The roles of a bag's topics. Reads the first messages of images, joints and wheels.

    Args:
        bag: transforms of tf that are used become topics of it.
        knows_wheels: whether a calibration gives the wheels' sizes.
        holonomic: the wheels of a calibration of a holonomic base, else None.

    Raises:
        ConfigError: a chosen topic does not exist, is empty, or has another type.
        RecordingError: a first message is damaged.
    """
    filled = [topic for topic in bag.topics if topic.count]
    types = {topic.name: topic.type for topic in filled}
    chosen = dict(choices.topics)
    for role, chosen_name in chosen.items():
        if chosen_name == NONE or role == "wheels":
            continue
        of_type = ", ".join(topic.name for topic in filled if topic.type in _TYPES[role])
        fix = f"there are: {of_type}" if of_type else f"the bag has none of {' or '.join(_TYPES[role])}"
        if chosen_name not in types:
            raise ConfigError(f"--topic {role}={chosen_name}: {bag.path.name} has no messages of it", fix=fix)
        if types[chosen_name] not in _TYPES[role]:
            raise ConfigError(f"--topic {role}={chosen_name} is of {types[chosen_name]}", fix=fix)
    warnings: list[str] = []
    color, depth = _cameras(bag, filled, chosen, warnings)
    infos = [topic.name for topic in filled if topic.type == INFO]
    frames = {name: bag.header(bag.first(name)[0]).frame for name in infos}
    color_info = None if color is None else chosen.get("color_info") or _info_of(color, frames)
    # Registered depth has the camera model of the colour image.
    own_depth = None if depth is None or depth.says_registered else depth
    depth_info = None if own_depth is None else chosen.get("depth_info") or _info_of(own_depth, frames)
    truth = _truth(bag, chosen, choices)
    faults: list[str] = []
    if holonomic is None:
        source = _wheels(bag, filled, color is not None, choices, knows_wheels, truth, warnings, faults)
    else:
        left_out = truth.of if isinstance(truth, TransformTopic) else truth
        source = _holonomic(bag, [topic for topic in filled if topic.name != left_out], choices, holonomic, warnings)
    gyro = chosen.get("gyro")
    if gyro is None:
        found = [topic.name for topic in filled if topic.type == IMU]
        gyro = found[0] if found else None
        if len(found) > 1:
            warnings.append(f"{gyro} is used as the gyroscope, not {', '.join(found[1:])}: see --topic gyro=….")
    elif gyro == NONE:
        gyro = None
    if source is not None and gyro is not None and "gyro" not in chosen and is_fused(source):
        warnings.append(f"{gyro} is left out: {source.topic.name} has it already, by its name: see --topic gyro=….")
        gyro = None
    transforms = tuple(one for one in (source and source.transform, truth) if isinstance(one, TransformTopic))
    bag.add_transforms(transforms)
    wheels = None if source is None else source.topic
    name = truth.name if isinstance(truth, TransformTopic) else truth
    return Roles(
        color, depth, color_info, depth_info, wheels, source, gyro, name, transforms, (*warnings, *faults), (*faults,)
    )


def _cameras(
    bag: OpenBag, filled: Sequence[Topic], chosen: Mapping[str, str], warnings: list[str]
) -> tuple[ImageTopic | None, ImageTopic | None]:
    """Colour and depth that most likely belong to one camera; both None where there is no such pair."""
    topics = [topic for topic in filled if topic.type in (IMAGE, COMPRESSED)]
    if len(topics) > _MOST_IMAGES:
        warnings.append(f"Of {len(topics)} topics of images, only the first {_MOST_IMAGES} by name are read.")
        topics = [topic for topic in topics if topic.name in chosen.values()] + topics[:_MOST_IMAGES]
    images = []
    for topic in topics:
        decoded = bag.decode(bag.first(topic.name)[0])
        encoding = str(decoded.format if topic.type == COMPRESSED else decoded.encoding)
        frame = str(decoded.header.frame_id).lstrip("/")
        images.append(ImageTopic(topic.name, frame, encoding, is_depth(encoding, topic.name)))
    by_name = {image.name: image for image in images}
    if chosen.get("color") == NONE or chosen.get("depth") == NONE:
        return None, None
    colors = [image for image in images if not image.is_depth and not _NO_COLOR.search(image.name)]
    depths = [image for image in images if image.is_depth]
    if "color" in chosen:
        colors = [by_name[chosen["color"]]]
    if "depth" in chosen:
        depths = [by_name[chosen["depth"]]]

    def unlikeliness(color: ImageTopic, depth: ImageTopic) -> tuple[int, ...]:
        """A sort key of pairs of topics: the least is the most likely pair of one camera's colour and depth."""
        parts = [_base(image.name).split("/") for image in (color, depth)]
        shared = next((i for i, (a, b) in enumerate(zip(*parts, strict=False)) if a != b), min(map(len, parts)))
        is_registered = color.frame == depth.frame or depth.says_registered
        by_word = next((i for i, word in enumerate(_COLOR_WORDS) if word.search(color.name)), len(_COLOR_WORDS))
        is_packed = sum(bool(_TRANSPORT.search(image.name)) for image in (color, depth))
        return (
            -shared if shared > 1 else 0,
            not is_registered,
            by_word,
            is_packed,
            color.is_rectified,
            depth.is_rectified,
        )

    both = [(color, depth) for color in colors for depth in depths if color is not depth]
    pairs = sorted((unlikeliness(color, depth), color.name, depth.name) for color, depth in both)
    if not pairs:
        names = ", ".join(image.name for image in (*colors, *depths))
        if names:
            other = "depth" if colors else "colour"
            warnings.append(f"Not used, since no {other} images match them: {names}.")
        return None, None
    (best, color, depth), others = pairs[0], pairs[1:]
    equals = [f"{c} with {d}" for unlikely, c, d in others if unlikely == best and _base(d) != _base(depth)]
    if equals:
        taken = f"{color} with {depth} is used, by its name alone"
        warnings.append(f"There are several cameras: {taken}, not {equals[0]}. Choose by --topic color=… and depth=….")
    return by_name[color], by_name[depth]


def _base(name: str) -> str:
    """The name of a topic without the suffix of its image transport."""
    return _TRANSPORT.sub("", name)


def _info_of(image: ImageTopic, frames: Mapping[str, str]) -> str | None:
    """The CameraInfo beside an image, else the only one of its frame, else the only one there is."""
    folder = _base(image.name).rpartition("/")[0]
    # The RealSense SDK writes …/image/data and …/info/camera_info.
    for beside in (f"{folder}/camera_info", f"{folder.rpartition('/')[0]}/info/camera_info"):
        if beside in frames:
            return beside
    alike = [name for name, frame in frames.items() if frame == image.frame and frame]
    if len(alike) == 1:
        return alike[0]
    return next(iter(frames)) if len(frames) == 1 else None


def _truth(bag: OpenBag, chosen: Mapping[str, str], choices: Choices) -> TransformTopic | str | None:
    """The topic of true poses, where the user chose one. Raises ConfigError."""
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


def _wheels(
    bag: OpenBag,
    filled: Sequence[Topic],
    has_camera: bool,
    choices: Choices,
    knows_wheels: bool,
    truth: TransformTopic | str | None,
    warnings: list[str],
    faults: list[str],
) -> WheelTopic | None:
    """The source of wheel motion: raw readings rather than a filter's output. Warnings name the sources not used."""
    name = choices.topics.get("wheels")
    if name == NONE:
        return None
    if name is not None:
        chosen = chosen_source(bag, name, choices.right, choices.sides)
        chosen, how = _as_it_moves(bag, chosen, knows_wheels, warnings)
        faults += [] if how is None else [f"{name} goes sideways: {how}; the path is wrong by as much."]
        return chosen
    own = any(topic.name == CALIBRATION for topic in filled)
    # In a bag that wheelsight wrote, poses and transforms are its estimate from the other sensors.
    is_estimated = own and (has_camera or any(topic.type == JOINTS for topic in filled))
    left_out = {truth.of if isinstance(truth, TransformTopic) else truth}
    found = sources_in(bag, [topic for topic in filled if topic.name not in left_out], choices.sides, is_estimated)
    usable = [source for source in found if knows_wheels or not source.needs_sizes]
    if not usable and not has_camera:
        usable = found
    others = [source for source in found if not usable or source is not usable[0]]
    taken, how = _as_it_moves(bag, usable[0], knows_wheels, warnings) if usable else (None, None)
    if taken is not None and how is not None:
        if not has_camera:
            faults.append(f"{taken.topic.name} goes sideways: {how}; without a camera the path is wrong by as much.")
        else:
            fix = f"the camera alone is used (--topic wheels={taken.topic.name} uses the wheels too)"
            warnings.append(f"{taken.topic.name} is left out: {how}; {fix}.")
            taken = None
    if taken is not None:
        warnings += [f"{taken.topic.name} is used as the wheels' odometry, {taken.doubt}."] if taken.doubt else []
    if taken is not None and others:
        names = ", ".join(f"{source.topic.name} ({source.why_not(knows_wheels)})" for source in others)
        warnings.append(f"{taken.topic.name} is used for the wheels, not {names}: see --topic wheels=….")
    elif others:
        names = ", ".join(f"{source.topic.name} ({source.why_not(knows_wheels)})" for source in others)
        warnings.append(f"Wheels are not used: {names}.")
    warnings += unread_topics(bag, filled, found) if taken is None else []
    return taken


def _as_it_moves(
    bag: OpenBag, source: WheelTopic, knows_wheels: bool, warnings: list[str]
) -> tuple[WheelTopic, str | None]:
    """The source, and how much it moves sideways where the calibration has two wheels, which cannot.

    Without a calibration a source that moves sideways becomes that of a holonomic base, with a warning.
    """
    how = sideways(bag, source)
    if how is None:
        return source, None
    if knows_wheels:
        return source, f"{how}, which two wheels cannot show"
    fix = "give a calibration.yaml with its wheels if it has two"
    warnings.append(f"{source.topic.name} is used as that of a holonomic base: {how} ({fix}).")
    return replace(source, is_holonomic=True), None


def _holonomic(
    bag: OpenBag, filled: Sequence[Topic], choices: Choices, wheels: HolonomicWheels, warnings: list[str]
) -> WheelTopic | None:
    """The source of a holonomic base that a calibration describes: counts of all wheels, else its own odometry."""
    name = choices.topics.get("wheels")
    if name == NONE:
        return None
    taken = holonomic_source(bag, filled, wheels, name, choices.places)
    others: list[WheelTopic] = []
    if taken is None and name is not None:
        taken = chosen_source(bag, name, choices.right, choices.sides)
    elif taken is None:
        own = any(topic.name == WHEEL_ODOMETRY for topic in filled)  # other topics of such a bag are estimates
        filled = [topic for topic in filled if topic.name == WHEEL_ODOMETRY] if own else filled
        found = sources_in(bag, filled, choices.sides, any(topic.name == CALIBRATION for topic in filled) and not own)
        taken = next((source for source in found if not source.needs_sizes), None)
        others = [source for source in found if source is not taken]
    if taken is not None and taken.needs_sizes and not taken.is_holonomic:
        problem = f"--topic wheels={taken.topic.name} is of two wheels, and the calibration has a holonomic base"
        raise ConfigError(problem, fix="name a topic of all its wheels, or of its odometry")
    if others:
        names = ", ".join(source.topic.name for source in others)
        what = "Wheels are not used" if taken is None else f"{taken.topic.name} is used for the wheels, not {names}"
        warnings.append(f"{what}: see --topic wheels=….")
    return None if taken is None else replace(taken, is_holonomic=True)


def lacks(roles: Roles, bag: OpenBag, path: Path) -> RecordingError:
    """The error for a bag with neither camera nor wheels."""
    types = {topic.type for topic in bag.topics if topic.count}
    none = ["counts or speeds of wheels", "odom → base_link in tf", "Odometry", "JointState of wheels"]
    missing = ["no depth images with colour", *(f"no {what}" for what in none)]
    others = "".join(f" {warning}" for warning in roles.warnings)
    shown = ", ".join(f"{topic.name} ({topic.type.rpartition('/')[2]}, {topic.count:,})" for topic in bag.topics)
    problem = f"holds nothing to localize by: {', '.join(missing)}.{others} Its topics: {shown or 'none'}"
    if not types:
        return RecordingError("holds no messages", path=path, fix="record again")
    return RecordingError(problem, path=path, fix="record colour, depth, camera_info, tf_static and odom")
