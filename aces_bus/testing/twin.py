"""Simulated devices on buses of their own, for tests and programs: the way to the room that makes them."""

from __future__ import annotations

from typing import Any

from ..errors import CallerError
from ..plugins import installed_points


def twin(driver: Any, /, **options: Any) -> Any:
    """Return simulated devices on a bus of their own, open: `with twin("odrive", node=3) as motor: motor.bus`.

    `driver` names one of `aces devices`, or is a robot; `options` are its numbers (`node=3`, `ids=[1, 2]`) and what
    `aces_lab.twins.open_bench` lists: a `Bench` of that package comes back. Raises `UnknownNameError` and `CallerError` for
    what there is not or cannot be, and where the package is not installed.
    """
    made = next(iter(installed_points("aces_bus.twins")), None)
    if made is None:
        raise CallerError("twin: the package aces_lab is not installed")
    return made.load()(driver, **options)


__all__ = ["twin"]
