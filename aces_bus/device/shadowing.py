"""Names that a device's or twin's class must not take from its base: found when the class is made, not on the robot."""

from __future__ import annotations

from collections.abc import Collection


def refuse_hidden(cls: type, attributes: Collection[str]) -> None:
    """Raise `TypeError` where a method could never be called: every instance has an attribute of that name."""
    for name in attributes:
        if callable(vars(cls).get(name)):
            raise TypeError(
                f"{cls.__name__}.{name}: every instance has an attribute {name!r}, which hides the method;"
                " choose another name"
            )


def refuse_shadowing(cls: type, name: str, role: str, *, mark: str = "") -> None:
    """Raise `TypeError` where `name`, which has a role in `cls`, replaces a method of a base that is for something else.

    Methods that carry the attribute `mark` have the same role, and may be replaced.
    """
    for base in cls.__mro__[1:]:
        other = vars(base).get(name)
        if other is None or (mark and hasattr(other, mark)):
            continue
        raise TypeError(
            f"{cls.__name__}.{name} is {role}, and would replace {base.__name__}.{name}; choose another name"
        )
