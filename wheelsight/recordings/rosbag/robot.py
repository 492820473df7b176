"""How the robot of a bag is built: its cameras by CameraInfo, their places by tf, its wheels by what tells of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from wheelsight.calibration import Calibration, HolonomicWheels
from wheelsight.errors import CalibrationError
from wheelsight.geometry import FloatArray, PinholeCamera
from wheelsight.recordings._wheel_recording import shipped_robot
from wheelsight.recordings.rosbag.cameras import camera_of
from wheelsight.recordings.rosbag.definitions import TF
from wheelsight.recordings.rosbag.realsense_sdk import joined
from wheelsight.recordings.rosbag.settings import BagSettings
from wheelsight.recordings.rosbag.storage import OpenBag
from wheelsight.recordings.rosbag.topics import ImageTopic, Roles
from wheelsight.recordings.rosbag.transforms import Transforms
from wheelsight.recordings.rosbag.wheel_topics import WheelSource

# REP 105's names; the first that tf joins with the camera is the base. What stands on the ground comes first.
_BASES = ("base_footprint", "base_link", "base")
_LOOKS_UP = 0.8  # of a camera's optical axis, upwards: no robot looks at the ceiling, but frames of bodies have z up


@dataclass(frozen=True, slots=True)
class Robot:
    """What a bag tells of its robot.

    Attributes:
        calibration: what is known, or None where that is nothing; then `lacks` says why.
        base: name of the base's frame, or None.
        transforms: of tf.
        warnings: one sentence each.
        lacks: why the camera is not known, where the bag has one.
        needs_cameras, needs_wheels: what a calibration must have for this bag to be used.
    """

    calibration: Calibration | None
    base: str | None
    transforms: Transforms
    warnings: tuple[str, ...]
    lacks: CalibrationError | None = None
    needs_cameras: bool = False
    needs_wheels: bool = False


def read_robot(bag: OpenBag, roles: Roles, settings: BagSettings) -> Robot:
    """The robot by CameraInfo, /tf_static, the first messages of /tf, and the kind of its wheels' topic."""
    transforms = _transforms(bag, roles, settings)
    warnings = list(transforms.warnings)
    base = _base(bag, roles, transforms)
    cameras, lacks = None, None
    if roles.color is not None and roles.depth is not None:
        try:
            cameras = _cameras(bag, roles, roles.color, roles.depth, transforms, settings, warnings)
        except CalibrationError as error:
            lacks = CalibrationError(error.problem, path=bag.path, fix=error.fix)
    T_base_camera = None if roles.depth is None else _mount(base, camera_frame(roles), transforms, warnings)
    wheels = None if roles.source is None or roles.needs_sizes else _nominal_wheels(roles.source)
    mount = None if T_base_camera is None else Calibration(T_base_camera=T_base_camera, source="tf")
    known = [part for part in (cameras, wheels, mount) if part is not None]
    calibration = reduce(Calibration.updated_by, known) if known else None
    if calibration is None and lacks is None:
        lacks = lacks_sizes(bag, roles)
    needs = (roles.color is not None, roles.needs_sizes)
    return Robot(calibration, base, transforms, tuple(warnings), lacks, *needs)


def _nominal_wheels(source: WheelSource) -> Calibration:
    """Wheels that stand for an odometry of which the bag says no more."""
    two = shipped_robot("velocities")
    if not source.is_holonomic:
        return two
    assert two.wheels is not None
    wheels = HolonomicWheels("increments", slip_m_per_sqrt_m=two.wheels.slip_m_per_sqrt_m)
    return Calibration(holonomic=wheels, source="nominal, a holonomic base whose own odometry is read")


def lacks_sizes(bag: OpenBag, roles: Roles) -> CalibrationError:
    """What to say of wheels of which nothing says how large they are."""
    named = "" if roles.source is None else f"{roles.source.topic.name} ({roles.source.tells}): "
    kinds = {"joints": "joint states tell", "fields": "these tell"}
    tell = "counts tell" if roles.source is None else kinds.get(roles.source.kind, "counts tell")
    problem = f"{named}{tell} how far wheels turn, but not how large they are"
    fix = "give a calibration.yaml with wheels (radii, track, ticks_per_turn) by --calibration"
    return CalibrationError(problem, path=bag.path, fix=fix)


def _transforms(bag: OpenBag, roles: Roles, settings: BagSettings) -> Transforms:
    transforms = Transforms(settings.tf_apart_m, settings.tf_apart_rad)
    parts = {part.name for part in roles.transforms}
    topics = [topic for topic in bag.topics if topic.type in TF and topic.count and topic.name not in parts]
    for topic in sorted(topics, key=lambda topic: "static" not in topic.name):
        is_static = "static" in topic.name
        for message in bag.first(topic.name, min(topic.count, settings.tf_messages)):
            if not transforms.add(bag.decode(message).transforms, is_static):
                return transforms
    return transforms


def _base(bag: OpenBag, roles: Roles, transforms: Transforms) -> str | None:
    """The base's frame: one of the usual names that tf joins with the camera, or what the odometry moves."""
    moved: list[str] = []
    if roles.source is not None and roles.source.kind == "odometry":
        moved = [str(bag.decode(bag.first(roles.source.topic.name)[0]).child_frame_id).lstrip("/")]
    elif roles.source is not None and roles.source.transform is not None:
        moved = [roles.source.transform.child]
    if roles.depth is None:
        return next(iter([*moved, _BASES[1]]))
    camera = camera_frame(roles)
    names = [_BASES[0], *moved, *_BASES[1:]]
    return next((name for name in names if name and transforms.between(name, camera) is not None), None)


def camera_frame(roles: Roles) -> str:
    """The frame in which depth is measured: the colour camera's where depth was registered to it."""
    assert roles.color is not None
    assert roles.depth is not None
    return roles.color.frame if roles.depth.says_registered else roles.depth.frame


def _mount(base: str | None, camera: str, transforms: Transforms, warnings: list[str]) -> FloatArray | None:
    """T_base_camera, or None where tf does not tell."""
    T = None if base is None else transforms.between(base, camera)
    if T is not None and T[2, 2] > _LOOKS_UP:
        seems = f"{camera!r} seems to be a frame of its body, not an optical one"
        warnings.append(f"By tf the camera looks upwards: {seems}. It is taken for one whose x axis looks ahead.")
        ahead = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
        return np.asarray(T @ ahead)
    if T is None:
        moves = ", ".join(f"{parent} to {child}" for parent, child in sorted(transforms.moving))
        why = f"{moves} moves" if moves else f"tf does not join {camera!r} with {' or '.join(_BASES)}"
        warnings.append(f"Nothing says where the camera sits on the robot: {why}. wheelsight calibrate base finds it.")
    return T


def _cameras(
    bag: OpenBag,
    roles: Roles,
    color: ImageTopic,
    depth: ImageTopic,
    transforms: Transforms,
    settings: BagSettings,
    warnings: list[str],
) -> Calibration:
    """Both cameras and how they are joined. Raises CalibrationError where nothing tells."""
    color_camera = _camera(bag, color, roles.color_info, settings, warnings)
    source = f"CameraInfo of {bag.path.name}"
    if depth.says_registered:
        return Calibration.registered_camera(color_camera, source=source)
    T_color_depth = joined(bag, color.name, depth.name)
    if T_color_depth is not None:
        warnings.append(f"{depth.name} is not registered to {color.name}: they are joined as the RealSense SDK has it.")
        own = _camera(bag, depth, roles.depth_info, settings, warnings)
        return Calibration(color_camera, own, T_color_depth, source=source)
    is_one = depth.frame == color.frame
    depth_camera = color_camera if is_one and roles.depth_info is None else None
    if depth_camera is None:
        depth_camera = _camera(bag, depth, roles.depth_info, settings, warnings)
    if is_one and _is_same(color_camera, depth_camera):
        return Calibration.registered_camera(color_camera, source=source)
    # tf joins a frame with itself, which says nothing of two cameras that carry its name.
    T_color_depth = None if is_one else transforms.between(color.frame, depth.frame)
    if T_color_depth is None:
        why = "and tf does not join them"
        if is_one:
            why = "both carry one frame with different CameraInfo, so that tf does not join them"
        problem = f"depth ({depth.frame!r}) is not registered to colour ({color.frame!r}), {why}"
        fix = "record /tf_static with a frame for each, or registered depth, or give T_color_depth by --camera"
        raise CalibrationError(problem, path=bag.path, fix=f"{fix}{_of_realsense(bag, depth)}")
    warnings.append(f"{depth.name} is not registered to {color.name}: they are joined by tf.")
    return Calibration(color_camera, depth_camera, T_color_depth, source=source)


def _of_realsense(bag: OpenBag, image: ImageTopic) -> str:
    """What else helps where the bag may be what the RealSense SDK recorded, which reads its own calibration."""
    of_sdk = image.name.startswith("/device_") or any(topic.name.startswith("/device_") for topic in bag.topics)
    file = f"realsense:{bag.path.name}" if of_sdk else "realsense:FILE"
    return f"; what the RealSense SDK recorded is read by wheelsight record --camera {file}"


def _is_same(color: PinholeCamera, depth: PinholeCamera) -> bool:
    """Whether both have one pixel grid; a registered image's lens distortion may be told, or not."""
    sizes = [(camera.width, camera.height) for camera in (color, depth)]
    return sizes[0] == sizes[1] and bool(np.allclose(color.K, depth.K, rtol=1e-3, atol=0.1))


def _camera(
    bag: OpenBag, image: ImageTopic, info: str | None, settings: BagSettings, warnings: list[str]
) -> PinholeCamera:
    if info is None:
        problem = f"no CameraInfo tells what the camera of {image.name} is like"
        fix = f"choose one by --topic color_info=…, or give --camera{_of_realsense(bag, image)}"
        raise CalibrationError(problem, fix=fix)
    try:
        camera, told = camera_of(bag.decode(bag.first(info)[0]), image.is_rectified, settings.lens_px)
    except CalibrationError as error:
        raise CalibrationError(f"{image.name} ({info}): {error.problem}", fix=error.fix or "give --camera") from error
    if told is not None:
        warnings.append(f"{info}: {told}.")
    return camera
