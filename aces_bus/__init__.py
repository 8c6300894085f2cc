"""Write a device's protocol once; get a scanner, an encoder and a proof that nothing is lost.

The public names are imported on use, so that `import aces_bus` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._lazy import lazy_names

if TYPE_CHECKING:
    from .frames import Frame
    from .protocol import (
        Protocol,
        Scanner,
        Unknown,
        as_dict,
        list_protocols,
        load_protocol,
        make_scanner,
    )
    from .recordings import open_recording
    from .recordings.decode import decode
    from .robot import load_robot
    from .testing.twin import twin

__version__ = "0.1.0"
__all__ = [
    "Frame",
    "Protocol",
    "Scanner",
    "Unknown",
    "as_dict",
    "decode",
    "list_protocols",
    "load_protocol",
    "load_robot",
    "make_scanner",
    "open_recording",
    "twin",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".frames": "Frame",
        ".protocol": "Protocol Scanner Unknown as_dict list_protocols load_protocol make_scanner",
        ".recordings": "open_recording",
        ".recordings.decode": "decode",
        ".robot": "load_robot",
        ".testing.twin": "twin",
    },
)
