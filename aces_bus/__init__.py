"""Write a device's protocol once; get a scanner, an encoder and a proof that nothing is lost.

The public names are imported on use, so that `import aces_bus` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .capture.decode import decode as decode
    from .frame import Frame as Frame
    from .protocol import Protocol as Protocol
    from .protocol import Scanner as Scanner
    from .protocol import Unknown as Unknown
    from .protocol import as_dict as as_dict
    from .protocol import list_protocols as list_protocols
    from .protocol import load_protocol as load_protocol
    from .protocol import make_scanner as make_scanner

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
    "make_scanner",
]


def __getattr__(name: str) -> Any:
    if name == "Frame":
        from .frame import Frame

        return Frame
    if name == "decode":
        from .capture.decode import decode

        return decode
    if name in __all__:
        from . import protocol

        return getattr(protocol, name)
    raise AttributeError(f"module 'aces_bus' has no attribute {name!r}")
