"""URDF files: robots' mechanisms read and written, as bodies of `aces_bus.kinematics`, and the torques that hold them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from aces_bus._lazy import lazy_names
from aces_bus.kinematics.bodies import BodyFormat

if TYPE_CHECKING:
    from .dynamics import Dynamics
    from .model import Inertia, Mimic, UrdfJoint, UrdfLink, UrdfModel, UrdfOrigin
    from .physics import UrdfPhysics, urdf_physics
    from .read import parse_urdf, read_urdf
    from .robots import model_of_body, model_of_robot
    from .write import urdf_text

__all__ = [
    "Dynamics",
    "Inertia",
    "Mimic",
    "UrdfJoint",
    "UrdfLink",
    "UrdfModel",
    "UrdfOrigin",
    "UrdfPhysics",
    "model_of_body",
    "model_of_robot",
    "parse_urdf",
    "read_urdf",
    "urdf_physics",
    "urdf_text",
]

FORMATS = (
    BodyFormat("urdf", ".urdf", "aces_lab.urdf.robots:urdf_body", "aces_lab.urdf.robots:robot_joints"),
)

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".dynamics": "Dynamics",
        ".model": "Inertia UrdfJoint UrdfLink Mimic UrdfModel UrdfOrigin",
        ".physics": "UrdfPhysics urdf_physics",
        ".read": "parse_urdf read_urdf",
        ".robots": "model_of_body model_of_robot",
        ".write": "urdf_text",
    },
)
