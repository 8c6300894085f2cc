"""Stop what a program leaves enabled when it ends without the end of its run.

1. It is done at interpreter exit, on real buses, for what was opened and not closed; what was left on purpose stays.
2. It is said on stderr, with the names; so is what has not stopped. A killed program cannot do it.
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..errors import AcesError
from ..runtime.loop import Loop

if TYPE_CHECKING:
    from .rig import Rig

#: What is open: the rig, what ends it, and the process that has opened it.
_open: dict[int, tuple[Rig, Callable[[], object], int]] = {}


def stop_at_exit(rig: Rig, end: Callable[[], object]) -> None:
    """Call `end` at interpreter exit if the rig still drives something then. Virtual time has nothing to stop."""
    if isinstance(rig.clock, Loop):
        _open[id(rig)] = rig, end, os.getpid()


def is_ended(rig: Rig) -> None:
    """Leave a rig alone at exit: it has had its end."""
    _open.pop(id(rig), None)


@atexit.register
def stop_forgotten() -> None:
    """Stop what is still driven by rigs that this process has opened."""
    for rig, end, process in list(_open.values()):
        driven = [device.name for device in rig.devices.values() if device.is_driven]
        if not driven or process != os.getpid():  # a fork has inherited it
            continue
        who = f"aces-bus: {rig.robot.name}"
        print(f"{who}: the program ended and left {', '.join(driven)} enabled: stopping", file=sys.stderr)
        try:
            end()
        except Exception as error:  # whatever it is, the other robots are stopped too
            said = error if isinstance(error, AcesError) else f"not stopped: {error!r}"
            print(f"{who}: {said}", file=sys.stderr)
        is_ended(rig)
