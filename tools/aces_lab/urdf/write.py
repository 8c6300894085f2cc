"""Models as URDF text. Read again, a text gives an equal model: numbers are written with all their digits."""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

from .model import Inertia, UrdfJoint, UrdfModel, UrdfOrigin


def urdf_text(model: UrdfModel) -> str:
    """Return a model as the text of a URDF file."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(model.name)}>"]
    for link in model.links.values():
        if link.inertia is None:
            lines.append(f"  <link name={quoteattr(link.name)}/>")
        else:
            lines += [f"  <link name={quoteattr(link.name)}>", *_inertial(link.inertia), "  </link>"]
    for joint in model.joints.values():
        lines += _joint(joint)
    return "\n".join([*lines, "</robot>", ""])


def _inertial(inertia: Inertia) -> Iterator[str]:
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = " ".join(f'{key}="{value!r}"' for key, value in zip(keys, inertia.moments, strict=True))
    yield "    <inertial>"
    yield f"      {_origin(inertia.origin)}"
    yield f'      <mass value="{inertia.mass!r}"/>'
    yield f"      <inertia {moments}/>"
    yield "    </inertial>"


def _joint(joint: UrdfJoint) -> Iterator[str]:
    yield f'  <joint name={quoteattr(joint.name)} type="{joint.kind}">'
    yield f"    {_origin(joint.origin)}"
    yield f"    <parent link={quoteattr(joint.parent)}/>"
    yield f"    <child link={quoteattr(joint.child)}/>"
    if joint.kind != "fixed":
        yield f'    <axis xyz="{_numbers(joint.axis)}"/>'
    # URDF wants effort and speed of a joint with a range; where they are not known, 0 is what others write.
    needs = joint.kind in ("revolute", "prismatic")
    limit = _keys(
        lower=joint.lower,
        upper=joint.upper,
        effort=0.0 if needs and joint.effort is None else joint.effort,
        velocity=0.0 if needs and joint.velocity is None else joint.velocity,
    )
    dynamics = _keys(damping=joint.damping, friction=joint.friction)
    yield from (f"    <{tag} {keys}/>" for tag, keys in (("limit", limit), ("dynamics", dynamics)) if keys)
    if joint.mimic is not None:
        name, multiplier, offset = joint.mimic
        yield f'    <mimic joint={quoteattr(name)} multiplier="{multiplier!r}" offset="{offset!r}"/>'
    yield "  </joint>"


def _origin(origin: UrdfOrigin) -> str:
    return f'<origin xyz="{_numbers(origin.xyz)}" rpy="{_numbers(origin.rpy)}"/>'


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value + 0.0!r}" for value in values)


def _keys(**values: float | None) -> str:
    return " ".join(f'{key}="{value!r}"' for key, value in values.items() if value is not None)
