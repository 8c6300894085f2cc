"""Write a device's protocol once; get a scanner, an encoder and a proof that nothing is lost.

The public names are imported on use, so that `import aces_bus` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._lazy import lazy_names

if TYPE_CHECKING:
    from .frame_table import FrameTable
    from .frames import Frame
    from .protocol.columns.scanner import make_column_scanner
    from .protocol.files import list_protocols, load_protocol
    from .protocol.live.scanner import make_scanner
    from .protocol.record import Unknown, as_dict
    from .python_can import frame_to_message
    from .recordings.convert import convert
    from .recordings.decode import decode
    from .recordings.open import open_recording
    from .robot.installed import list_robots, load_robot
    from .testing.twin import twin
    from .version import __version__ as __version__

__all__ = [
    "Frame",
    "FrameTable",
    "Unknown",
    "as_dict",
    "convert",
    "decode",
    "frame_to_message",
    "list_protocols",
    "list_robots",
    "load_protocol",
    "load_robot",
    "make_column_scanner",
    "make_scanner",
    "open_recording",
    "twin",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".version": "__version__",
        ".frame_table": "FrameTable",
        ".frames": "Frame",
        ".protocol.columns.scanner": "make_column_scanner",
        ".protocol.files": "list_protocols load_protocol",
        ".protocol.live.scanner": "make_scanner",
        ".protocol.record": "Unknown as_dict",
        ".python_can": "frame_to_message",
        ".recordings.convert": "convert",
        ".recordings.decode": "decode",
        ".recordings.open": "open_recording",
        ".robot.installed": "list_robots load_robot",
        ".testing.twin": "twin",
    },
)
