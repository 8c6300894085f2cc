"""URDF files as models.

1. A file of strangers: bounded, without entities (`xml.py`); names and numbers are checked before they are used.
2. What is wrong stops the reading, with its line: a mechanism that lacks a part would be another one.
3. A floating or planar joint `J` becomes joints of one axis, `J_x`, `J_y`, … (`UrdfJoint.part_of`), which no motor moves.
4. What a `UrdfModel` has no place for (shapes, materials, transmissions, sensors, extensions of simulators) is passed over.

Source: wiki.ros.org/urdf/XML; urdfdom's parser, where that page is silent (defaults of limits, joints without an axis).
"""

from __future__ import annotations

import math
import re
from typing import Final

from aces_bus.errors import CallerError
from aces_bus.plain_text import printable

from .model import ZERO, Inertia, Kind, Mimic, UrdfJoint, UrdfLink, UrdfModel, UrdfOrigin, Vector
from .xml import Element, parse_xml, read_file

#: Characters of a name: no control characters, nothing that ends a line, no blanks at its ends.
_NAME: Final = re.compile(r"[^\s\x00-\x1f\x7f](?:[^\x00-\x1f\x7f]{0,98}[^\s\x00-\x1f\x7f])?")
_KINDS: Final[dict[str, Kind]] = {
    "revolute": "revolute",
    "continuous": "continuous",
    "prismatic": "prismatic",
    "fixed": "fixed",
}
#: Joints of several axes, which become as many joints.
_FREE: Final = ("floating", "planar")


def read_urdf(path: str) -> UrdfModel:
    """Return the model of a URDF file. Raises `CallerError` with file and line."""
    return parse_urdf(read_file(path), path)


def parse_urdf(data: bytes | str, file: str = "robot.urdf") -> UrdfModel:
    """Return the model of a URDF text; messages call it `file`. Raises `CallerError` with file and line."""
    top = parse_xml(data.encode() if isinstance(data, str) else data, file)
    if top.tag != "robot":
        top.fail("not a URDF file: the outermost element is <robot>")
    for element in top.children:
        if element.tag.startswith("xacro:"):
            element.fail("this is xacro, which is a program: run xacro, and read what it prints")
    links = [_link(element) for element in top.all("link")]
    if not links:
        top.fail("no <link>")
    joints: list[UrdfJoint] = []
    for element in top.all("joint"):
        if element.attributes.get("type") in _FREE:
            between, parts = _free_joint(element)
            links += between
            joints += parts
        else:
            joints.append(_joint(element))
    try:
        return UrdfModel(_name(top), links, joints)
    except CallerError as error:
        raise CallerError(f"{file}: {error}") from error


def _link(element: Element) -> UrdfLink:
    name = _name(element)
    inertial = element.child("inertial")
    if inertial is None:
        return UrdfLink(name)
    mass, moments = inertial.child("mass"), inertial.child("inertia")
    weight = 0.0 if mass is None else _number(mass, "value")
    if weight < 0:
        (mass or inertial).fail(f"link {name}: a mass of {weight:g} kg; it is 0 or more")
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    xx, xy, xz, yy, yz, zz = (0.0 if moments is None else _number(moments, key, 0.0) for key in keys)
    return UrdfLink(name, Inertia(weight, _origin(inertial), (xx, xy, xz, yy, yz, zz)))


def _joint(element: Element) -> UrdfJoint:
    name = _name(element)
    kind = element.attributes.get("type", "")
    if kind not in _KINDS:
        element.fail(
            f"joint {name}: there is no type {printable(kind)[:40]!r} ({', '.join((*_KINDS, *_FREE))})"
        )
    unit = _axis(element) if kind != "fixed" else (1.0, 0.0, 0.0)
    limit, dynamics, mimic = element.child("limit"), element.child("dynamics"), element.child("mimic")
    lower = upper = None
    if limit is not None and kind in ("revolute", "prismatic"):
        lower, upper = _number(limit, "lower", 0.0), _number(limit, "upper", 0.0)
        if lower > upper:
            limit.fail(f"joint {name}: lower {lower:g} is above upper {upper:g}")
        if lower == upper:
            lower = upper = None  # both absent, or a joint that its file takes as stuck: no range is stated
    return UrdfJoint(
        name,
        _KINDS[kind],
        _reference(element, "parent"),
        _reference(element, "child"),
        _origin(element),
        unit,
        lower,
        upper,
        _optional(limit, "velocity"),
        _optional(limit, "effort"),
        _optional(dynamics, "damping"),
        _optional(dynamics, "friction"),
        None
        if mimic is None or kind == "fixed"
        else Mimic(_name(mimic, "joint"), _number(mimic, "multiplier", 1.0), _number(mimic, "offset", 0.0)),
    )


def _axis(element: Element) -> Vector:
    """Return the direction of a joint's axis, in its own frame."""
    axis = element.child("axis")
    x, y, z = (1.0, 0.0, 0.0) if axis is None else _vector(axis, "xyz")
    length = math.hypot(x, y, z)
    if length == 0:
        element.fail(f"joint {_name(element)}: its axis is 0 0 0; give it a direction")
    is_unit = abs(length - 1) < 1e-14  # as a division by the length leaves it
    return (x, y, z) if is_unit else (x / length, y / length, z / length)


def _free_joint(element: Element) -> tuple[list[UrdfLink], list[UrdfJoint]]:
    """Return a floating or planar joint as joints of one axis, and the massless links between them.

    Floating: along x, y, z of the joint's frame, then yaw, pitch, roll (about z, y, x). Planar: along two axes of the plane
    that its axis stands on (x and y where that is z), then about the axis.
    """
    name, parent, child = _name(element), _reference(element, "parent"), _reference(element, "child")
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    if element.attributes["type"] == "floating":
        parts = [("x", x), ("y", y), ("z", z), ("yaw", z), ("pitch", y), ("roll", x)]
    else:
        normal = _axis(element)
        to_axis = _turned_to(normal)
        parts = [("x", to_axis[0]), ("y", to_axis[1]), ("yaw", normal)]
    links: list[UrdfLink] = []
    joints: list[UrdfJoint] = []
    for place, (part, axis) in enumerate(parts):
        end = child if place + 1 == len(parts) else f"{name}_{part}"
        kind: Kind = "prismatic" if part in ("x", "y", "z") else "continuous"
        origin = UrdfOrigin() if place else _origin(element)
        joints.append(UrdfJoint(f"{name}_{part}", kind, parent, end, origin, axis, part_of=name))
        links += [UrdfLink(end)] if end != child else []
        parent = end
    return links, joints


def _turned_to(normal: Vector) -> tuple[Vector, Vector]:
    """Return two axes that make a right-handed frame with a normal: x and y where it is z."""
    x, y, z = normal
    if z == 1.0:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    # The axis of the frame that is furthest from the normal, made perpendicular to it.
    first = [0.0, 0.0, 0.0]
    place = min(range(3), key=lambda number: abs(normal[number]))
    first[place] = 1.0
    along = normal[place]
    a, b, c = (value - along * part for value, part in zip(first, normal, strict=True))
    length = math.hypot(a, b, c)
    a, b, c = a / length, b / length, c / length
    return (a, b, c), (y * c - z * b, z * a - x * c, x * b - y * a)


def _reference(element: Element, tag: str) -> str:
    """Return the link that a joint names."""
    found = element.child(tag)
    if found is None:
        element.fail(f"joint {_name(element)} names no {tag}: <{tag} link=…/>")
    return _name(found, "link")


def _name(element: Element, key: str = "name") -> str:
    text = element.attributes.get(key, "")
    if not _NAME.fullmatch(text):
        element.fail(
            f"{key}={printable(text)[:60]!r} is not a name: 1 to 100 printable characters, no blank at its ends"
        )
    return text


def _origin(element: Element) -> UrdfOrigin:
    origin = element.child("origin")
    return UrdfOrigin() if origin is None else UrdfOrigin(_vector(origin, "xyz"), _vector(origin, "rpy"))


def _vector(element: Element, key: str) -> Vector:
    text = element.attributes.get(key)
    if text is None:
        return ZERO
    words = text.split()
    if len(words) != 3:
        element.fail(f"{key}={printable(text)[:60]!r} is not three numbers")
    x, y, z = (_value(element, key, word) for word in words)
    return x, y, z


def _optional(element: Element | None, key: str) -> float | None:
    return None if element is None or key not in element.attributes else _number(element, key)


def _number(element: Element, key: str, default: float | None = None) -> float:
    text = element.attributes.get(key)
    if text is None:
        if default is None:
            element.fail(f"{key} is missing")
        return default
    return _value(element, key, text)


def _value(element: Element, key: str, word: str) -> float:
    try:
        value = float(word) if len(word) <= 40 and "_" not in word else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        element.fail(f"{key}={printable(word)[:60]!r} is not a finite number")
    return value
