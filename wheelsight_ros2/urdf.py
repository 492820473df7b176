"""`robot_of_urdf` reads mounts, wheels and footprint of a robot from its URDF; `urdf_of` writes one that RViz shows.

The format is described at https://wiki.ros.org/urdf/XML. Neither entities nor document types are read: a few lines of
them can fill the memory.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, indent, tostring
from xml.parsers import expat

import numpy as np

from wheelsight.core.calibration import FORMAT, Calibration
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.files import StrPath
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.inputs import Kind, read_bytes, read_text
from wheelsight_export.bag_writing import JOINTS, T_LINK_OPTICAL
from wheelsight_export.topics import BASE, COLOR_FRAME, DEPTH_FRAME, LINK

_KIND = Kind("a URDF", 8, fix="check the path; a .xacro becomes one by: xacro robot.xacro > robot.urdf")
_STL = Kind("a mesh", 128, fix="check the path in the URDF, or name its package by --package NAME=FOLDER")
_MOST_DEEP, _MOST_ELEMENTS, _MOST_LINKS = 64, 100_000, 2000
_BASES = ("base_footprint", "base_link", "base")
_WHEEL, _NO_WHEEL = re.compile(r"wheel|whl", re.I), re.compile(r"caster|castor|support|steer", re.I)
_OPTICAL = re.compile(r"optical", re.I)
_CAMERA, _NO_CAMERA = (
    re.compile(r"camera|depth|rgbd?|kinect|realsense|xtion", re.I),
    re.compile(r"infra|_ir|imu|gyro|accel"),
)
# An axle that leaves the robot's left by more than this is no driven wheel's.
_MOST_TILT = 0.1
_FARTHEST_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class UrdfRobot:
    """A robot as a URDF describes it, in the frame between its driven wheels on the ground: x forward, y left, z up.

    Attributes:
        T_base_camera: (4, 4) of the optical frame of depth; None without a camera.
        camera: that link's name; "" without one.
        radii_m: of the left and the right wheels; None without wheels.
        track_m: between the wheels; None without wheels.
        wheels: names of the joints.
        outline: (front, back, width) of the collision geometry, metres; None without any.
        warnings: what was left out, one sentence each.
    """

    T_base_camera: FloatArray | None
    camera: str
    radii_m: tuple[float, float] | None
    track_m: float | None
    wheels: tuple[str, ...]
    outline: tuple[float, float, float] | None
    warnings: tuple[str, ...]

    @property
    def layer(self) -> dict[str, Any]:
        """Fields of a calibration.yaml; counts of the wheels' encoders are in no URDF."""
        fields: dict[str, Any] = {"format": FORMAT}
        if self.T_base_camera is not None:
            fields["T_base_camera"] = self.T_base_camera.tolist()
        if self.radii_m is not None:
            left_m, right_m = self.radii_m
            fields["wheels"] = {"left_radius_m": left_m, "right_radius_m": right_m, "track_width_m": self.track_m}
        return fields


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: FloatArray
    axis: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """A geometry of a link: its points (N, 3) in the link, and the radius of a cylinder or sphere."""

    points: FloatArray
    radius_m: float | None
    is_collision: bool


@dataclass(slots=True, eq=False)
class _Tree:
    path: Path
    joints: dict[str, _Joint]  # by child
    links: dict[str, list[_Shape]]
    warnings: list[str] = field(default_factory=list)

    def refuse(self, problem: str, fix: str) -> NoReturn:
        raise CalibrationError(problem, path=self.path, fix=fix)

    def root_of(self, link: str) -> tuple[str, FloatArray]:
        """The root above a link, and T_root_link. Raises CalibrationError for a circle."""
        T, seen = np.eye(4), {link}
        while link in self.joints:
            joint = self.joints[link]
            T, link = se3.compose(joint.T_parent_child, T), joint.parent
            if link in seen:
                self.refuse(f"joints go in a circle at the link {link}", "each link has one parent")
            seen.add(link)
        return link, T

    def between(self, parent: str, child: str) -> FloatArray | None:
        """T_parent_child with all joints at zero; None where nothing joins them."""
        (a, T_a), (b, T_b) = self.root_of(parent), self.root_of(child)
        return se3.compose(se3.invert(T_a), T_b) if a == b else None


def robot_of_urdf(
    path: StrPath, *, base: str | None = None, camera: str | None = None, packages: Mapping[str, StrPath] | None = None
) -> UrdfRobot:
    """Read a URDF.

    Args:
        path: of the file.
        base: link on the robot's body; None for base_footprint, base_link or base, else the root.
        camera: link of depth; None for the likeliest by its name.
        packages: folders of ROS packages, in which `package://` meshes lie.

    Raises:
        CalibrationError: it is no URDF, its joints form no tree, wheels have no radius; names file and fix.
        ConfigError: a named link does not exist.
    """
    tree = _tree(Path(path), {name: Path(folder) for name, folder in (packages or {}).items()})
    for option, name in (("--base", base), ("--camera-link", camera)):
        if name is not None and name not in tree.links:
            raise ConfigError(f"{option} {name}: {tree.path.name} has no such link", fix=", ".join([*tree.links][:12]))
    roots = [link for link in tree.links if link not in tree.joints]
    body = base or next((name for name in _BASES if name in tree.links), roots[0] if roots else next(iter(tree.links)))
    left, right = _wheels(tree, body)
    T_body_base, radii_m, track_m = np.eye(4), None, None
    if left and right:
        radii_m = float(np.mean([one.radius_m for one in left])), float(np.mean([one.radius_m for one in right]))
        sides = [np.mean([one.at for one in side], axis=0) for side in (left, right)]
        track_m = float(sides[0][1] - sides[1][1])
        T_body_base[:3, 3] = (sides[0] + sides[1]) / 2
        T_body_base[2, 3] -= sum(radii_m) / 2
    else:
        tree.warnings.append(
            "it has no driven wheels on both sides: the base is taken as it is, and no wheels are written"
        )
    link = camera or _camera_link(tree)
    T_base_camera = None
    if link is not None:
        T_body_link = tree.between(body, link)
        if T_body_link is None:
            tree.refuse(f"no joints lead from {body} to {link}", "--base and --camera-link of one robot")
        T_link_optical = np.eye(4)
        if not _OPTICAL.search(link):
            T_link_optical = T_LINK_OPTICAL
            tree.warnings.append(f"{link} is taken for a camera's body, x forward: its name says no optical frame")
        T_base_camera = se3.compose(se3.invert(T_body_base), se3.compose(T_body_link, T_link_optical))
    outline = _outline(tree, body, T_body_base)
    names = tuple(one.name for one in (*left, *right))
    return UrdfRobot(T_base_camera, link or "", radii_m, track_m, names, outline, tuple(tree.warnings))


@dataclass(frozen=True, slots=True, eq=False)
class _Wheel:
    name: str
    at: FloatArray
    radius_m: float


def _wheels(tree: _Tree, body: str) -> tuple[list[_Wheel], list[_Wheel]]:
    """The left and the right driven wheels: turning joints with an axle to the left, by their names and places."""
    found: list[_Wheel] = []
    for joint in tree.joints.values():
        named = f"{joint.name} {joint.child}"
        if joint.kind != "continuous" or not _WHEEL.search(named) or _NO_WHEEL.search(named):
            continue
        T = tree.between(body, joint.child)
        if T is None:
            continue
        axis = T[:3, :3] @ joint.axis
        if abs(abs(axis[1]) - 1) > _MOST_TILT:
            tree.warnings.append(f"{joint.name} is no driven wheel's: its axle does not lead to the left")
            continue
        radii_m = [one.radius_m for one in tree.links[joint.child] if one.radius_m is not None]
        if not radii_m:
            fix = "give its link a cylinder, a sphere or an STL mesh; --package NAME=FOLDER for meshes of packages"
            tree.refuse(f"the wheel {joint.child} has no radius", fix)
        found.append(_Wheel(joint.name, T[:3, 3], max(radii_m)))
    return [one for one in found if one.at[1] > 0], [one for one in found if one.at[1] < 0]


def _camera_link(tree: _Tree) -> str | None:
    """The likeliest link of depth: an optical frame before a body, depth before colour."""
    named = [link for link in tree.links if _CAMERA.search(link) and not _NO_CAMERA.search(link)]

    def rank(link: str) -> tuple[bool, bool]:
        return not _OPTICAL.search(link), "depth" not in link.lower()

    ranked = sorted(named, key=rank)
    alike = [link for link in ranked[1:4] if rank(link) == rank(ranked[0])]
    if alike:
        others = ", ".join(alike)
        tree.warnings.append(f"{ranked[0]} is taken for the depth camera, not {others}: see --camera-link")
    return ranked[0] if ranked else None


def _outline(tree: _Tree, body: str, T_body_base: FloatArray) -> tuple[float, float, float] | None:
    """Front, back and width of all collision geometry, else of all that is visible."""
    points: dict[bool, list[FloatArray]] = {True: [], False: []}
    for link, shapes in tree.links.items():
        T = tree.between(body, link)
        if T is not None:
            for shape in shapes:
                T_base_link = se3.compose(se3.invert(T_body_base), T)
                points[shape.is_collision].append(se3.apply(T_base_link, shape.points))
    taken = points[True] or points[False]
    if not taken:
        return None
    x, y = np.concatenate(taken)[:, :2].T
    front_m, back_m, half_m = float(x.max()), float(-x.min()), float(np.abs(y).max())
    if min(front_m, back_m, half_m) <= 0:
        tree.warnings.append("the geometry does not surround the axle: no footprint is written")
        return None
    return front_m, back_m, 2 * half_m


def _parsed(path: Path) -> Element:
    """The root element. Raises CalibrationError for a document type, entities, and what is no XML."""
    text = read_text(path, _KIND, CalibrationError)
    parser, builder = expat.ParserCreate(), TreeBuilder()
    depth = count = 0

    def refuse(problem: str, fix: str = "write it without") -> NoReturn:
        raise CalibrationError(problem, path=path, line=parser.CurrentLineNumber, fix=fix)

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _MOST_DEEP or count > _MOST_ELEMENTS:
            refuse(f"has more than {_MOST_DEEP} levels or {_MOST_ELEMENTS:,} elements", "write a smaller one")
        if name.startswith("xacro:"):
            refuse("is a xacro", "xacro robot.xacro > robot.urdf")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = lambda *_: refuse("has a document type, which is not read")
    parser.EntityDeclHandler = lambda *_: refuse("has entities, which are not read")
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise CalibrationError(
            f"is no XML: {expat.errors.messages[error.code]}", path=path, line=error.lineno, fix=_KIND.fix
        ) from error
    root = builder.close()
    if root.tag != "robot":
        raise CalibrationError(f"its first element is {root.tag!r}, not 'robot'", path=path, fix=_KIND.fix)
    return root


def _tree(path: Path, packages: Mapping[str, Path]) -> _Tree:
    root = _parsed(path)
    tree = _Tree(path, {}, {})
    links = root.findall("link")
    if not links or len(links) > _MOST_LINKS:
        tree.refuse(f"has {len(links):,} links", f"1 to {_MOST_LINKS:,}")
    for link in links:
        tree.links[_name(tree, link)] = [*_shapes(tree, link, packages)]
    for one in root.findall("joint"):
        name, ends = _name(tree, one), []
        for end in ("parent", "child"):
            element = one.find(end)
            link_name = "" if element is None else element.get("link", "")
            if link_name not in tree.links:
                tree.refuse(f"the joint {name} has no {end} link: {link_name!r}", "name a link of the file")
            ends.append(link_name)
        if ends[1] in tree.joints:
            tree.refuse(f"the link {ends[1]} has two parents", "each link has one joint above it")
        axis_of = one.find("axis")
        axis = np.array([1.0, 0.0, 0.0]) if axis_of is None else _numbers(tree, axis_of, "xyz", 3)
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            tree.refuse(f"the axis of the joint {name} is 0", "such as xyz='0 1 0'")
        tree.joints[ends[1]] = _Joint(name, one.get("type", ""), ends[0], ends[1], _origin(tree, one), axis / length)
    for link_name in tree.links:
        tree.root_of(link_name)
    return tree


def _name(tree: _Tree, element: Element) -> str:
    name = element.get("name", "")
    if not name:
        tree.refuse(f"a {element.tag} has no name", "give it one")
    return name


def _numbers(tree: _Tree, element: Element, attribute: str, count: int, default: str | None = None) -> FloatArray:
    """An attribute of some numbers. Raises CalibrationError."""
    text = element.get(attribute, default)
    try:
        values = [float(part) for part in (text or "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(math.isfinite(value) and abs(value) <= 1e6 for value in values):
        tree.refuse(f"{element.tag} {attribute} is {str(text)[:60]!r}", f"{count} numbers")
    return np.array(values)


def _origin(tree: _Tree, element: Element) -> FloatArray:
    T, origin = np.eye(4), element.find("origin")
    if origin is None:
        return T
    T[:3, 3] = _numbers(tree, origin, "xyz", 3, "0 0 0")
    if np.abs(T[:3, 3]).max() > _FARTHEST_M:
        tree.refuse(f"an origin is {T[:3, 3].tolist()} m away", "metres, not millimetres")
    roll, pitch, yaw = _numbers(tree, origin, "rpy", 3, "0 0 0")
    T[:3, :3] = so3.exp(np.array([0, 0, yaw])) @ so3.exp(np.array([0, pitch, 0])) @ so3.exp(np.array([roll, 0, 0]))
    return T


def _shapes(tree: _Tree, link: Element, packages: Mapping[str, Path]) -> Iterator[_Shape]:
    """Geometry of a link that has a size."""
    for kind in ("collision", "visual"):
        for one in link.findall(kind):
            geometry = one.find("geometry")
            shape = None if geometry is None else next(iter(geometry), None)
            if shape is None:
                continue
            points, radius_m = _points(tree, shape, packages)
            if points is not None:
                yield _Shape(se3.apply(_origin(tree, one), points), radius_m, kind == "collision")


def _points(tree: _Tree, shape: Element, packages: Mapping[str, Path]) -> tuple[FloatArray | None, float | None]:
    """Points (N, 3) that have the shape's extent, and its radius."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    if shape.tag == "box":
        return corners * _numbers(tree, shape, "size", 3) / 2, None
    if shape.tag == "sphere":
        radius_m = float(_numbers(tree, shape, "radius", 1)[0])
        return np.concatenate([np.eye(3), -np.eye(3)]) * radius_m, radius_m
    if shape.tag == "cylinder":
        radius_m = float(_numbers(tree, shape, "radius", 1)[0])
        half_m = float(_numbers(tree, shape, "length", 1)[0]) / 2
        angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
        ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) * radius_m
        return np.concatenate([ring + (0, 0, half_m), ring - (0, 0, half_m)]), radius_m
    if shape.tag != "mesh":
        return None, None
    name = shape.get("filename", "")
    points = _mesh(tree, name, packages)
    if points is None:
        return None, None
    points = points * _numbers(tree, shape, "scale", 3, "1 1 1")
    low, high = points.min(axis=0), points.max(axis=0)
    # A wheel's box is square across its axle: half of its two sides that are alike.
    sides = np.sort(high - low)
    pairs = sides[1:] if sides[2] - sides[1] <= sides[1] - sides[0] else sides[:2]
    return (low + high) / 2 + corners * (high - low) / 2, float(pairs.mean()) / 2


def _mesh(tree: _Tree, name: str, packages: Mapping[str, Path]) -> FloatArray | None:
    """Corners (N, 3) of an STL mesh; None, with a warning, for what cannot be read."""
    package, _, rest = name.removeprefix("package://").partition("/")
    path = tree.path.parent / name.removeprefix("file://")
    if name.startswith("package://"):
        if package not in packages:
            tree.warnings.append(f"{name} is left out: --package {package}=FOLDER names where it lies")
            return None
        path = packages[package] / rest
    if path.suffix.lower() != ".stl":
        tree.warnings.append(f"{name} is left out: of meshes STL is read")
        return None
    data = read_bytes(path, _STL, CalibrationError)
    if data[:5] == b"solid" and b"facet" in data[:1024]:
        found = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data)
        try:
            points = np.array(found, dtype="S32").astype(float).reshape(-1, 3)
        except ValueError as error:
            raise CalibrationError("a vertex is no numbers", path=path, fix=_STL.fix) from error
    else:
        count = int.from_bytes(data[80:84], "little")
        if len(data) != 84 + 50 * count:
            raise CalibrationError(f"has {len(data):,} bytes for {count:,} triangles", path=path, fix=_STL.fix)
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("about", "<u2")])
        points = np.frombuffer(data, kind, count, 84)["corners"].reshape(-1, 3).astype(float)
    if not len(points) or not np.isfinite(points).all():
        raise CalibrationError("has no finite corners", path=path, fix=_STL.fix)
    return points


# A body that is drawn where a calibration says nothing of its height.
_HEIGHT_M, _WHEEL_M, _CAMERA_M = 0.25, 0.04, 0.03


def urdf_of(calibration: Calibration, name: str, outline: Sequence[float] | None = None) -> str:
    """A URDF of a calibration's frames: the names are those of /tf_static and /joint_states.

    Args:
        calibration: of the robot.
        name: of the robot.
        outline: front, back and width of the robot, metres; None for no body.
    """
    robot = Element("robot", name=name)
    base = SubElement(robot, "link", name=BASE)
    if outline is not None:
        front_m, back_m, width_m = outline
        height_m = _HEIGHT_M if calibration.wheels is None else 2 * calibration.wheels.left_radius_m
        T = np.eye(4)
        T[:3, 3] = (front_m - back_m) / 2, 0, height_m / 2
        for kind in ("visual", "collision"):
            _add_shape(base, kind, T, "box", size=_text([front_m + back_m, width_m, height_m]))
    wheels = calibration.wheels
    if wheels is not None:
        turned = np.eye(4)
        turned[:3, :3] = so3.exp(np.array([np.pi / 2, 0, 0]))
        radii_m = (wheels.left_radius_m, wheels.right_radius_m)
        for joint, side, radius_m in zip(JOINTS, (1, -1), radii_m, strict=True):
            link = joint.removesuffix("_joint")
            about = {"radius": _text([radius_m]), "length": _text([_WHEEL_M])}
            for kind in ("visual", "collision"):
                element = robot.find(f"link[@name='{link}']")
                element = SubElement(robot, "link", name=link) if element is None else element
                _add_shape(element, kind, turned, "cylinder", **about)
            T = np.eye(4)
            # Both lie on one axle: where radii differ, its middle has their mean height.
            T[:3, 3] = 0, side * wheels.track_width_m / 2, sum(radii_m) / 2
            _add_joint(robot, joint, "continuous", (BASE, link), T, axis=True)
    if calibration.T_base_camera is not None:
        T_base_link = se3.compose(calibration.T_base_camera, se3.invert(T_LINK_OPTICAL))
        link_of = SubElement(robot, "link", name=LINK)
        _add_shape(link_of, "visual", np.eye(4), "box", size=_text([_CAMERA_M, 3 * _CAMERA_M, _CAMERA_M]))
        _add_joint(robot, f"{LINK}_joint", "fixed", (BASE, LINK), T_base_link)
        T_link_color = se3.compose(T_LINK_OPTICAL, se3.invert(calibration.T_color_camera))
        for frame, T in ((DEPTH_FRAME, T_LINK_OPTICAL), (COLOR_FRAME, T_link_color)):
            SubElement(robot, "link", name=frame)
            _add_joint(robot, f"{frame}_joint", "fixed", (LINK, frame), T)
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def _add_shape(link: Element, kind: str, T: FloatArray, shape: str, **about: str) -> None:
    element = SubElement(link, kind)
    SubElement(element, "origin", xyz=_text(T[:3, 3]), rpy=_text(_rpy(T)))
    SubElement(SubElement(element, "geometry"), shape, about)


def _add_joint(
    robot: Element, name: str, kind: str, ends: tuple[str, str], T: FloatArray, *, axis: bool = False
) -> None:
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=ends[0])
    SubElement(joint, "child", link=ends[1])
    SubElement(joint, "origin", xyz=_text(T[:3, 3]), rpy=_text(_rpy(T)))
    if axis:
        SubElement(joint, "axis", xyz="0 1 0")


def _rpy(T: FloatArray) -> tuple[float, float, float]:
    """Turns about the fixed axes x, y, z, in this order."""
    R = T[:3, :3]
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    if math.hypot(R[0, 0], R[1, 0]) < 1e-9:  # straight up or down: roll and yaw are one turn
        return math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
