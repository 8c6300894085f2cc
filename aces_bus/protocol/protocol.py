"""A protocol as users have it: declared, and with the scanners and columns that are made from it.

1. Declarations know nothing of what reads them: this module is above scanners and columns, `declare.protocol` below.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .declare.message import GivenWay
from .declare.protocol import Configuration, DeclaredProtocol

if TYPE_CHECKING:
    from .live.scanner import Scanner


class Protocol(DeclaredProtocol):
    """A protocol's declaration; see docs/tutorial.md, and docs/reference/templates.md for all keywords.

    `dialects` maps names to what they are; `dialect` is the default one. `configurations` maps a name to its tables, each
    from a captured number to an entry (`{"hubo2": {"channels": {0x00: 2, …}}}`); `configuration` is the default one.
    `broadcast` gives the value of a captured field that addresses every device. `bitrate` (CAN) is
    in bit/s, `baud` (serial) in baud; `half_duplex`: all share one pair of wires, and who was asked answers next. `source`
    says where the facts come from.
    """

    def scanner(
        self,
        *,
        dialect: str | None = None,
        configuration: str | Configuration | None = None,
        direction: GivenWay | None = None,
        include_unknown: bool = False,
        raw: bool = False,
        check_thread: bool = False,
    ) -> Scanner:
        """Return a scanner of this protocol alone, for one thread; see `make_scanner`, which takes several on one wire.

        With `raw`, records have the numbers on the wire, without units, scales and names.
        """
        from .live.scanner import make_scanner

        return make_scanner(
            [self.variant(dialect, configuration)],
            direction=direction,
            include_unknown=include_unknown,
            raw=raw,
            check_thread=check_thread,
        )

    def _repr_html_(self) -> str:
        from ..plain_text import html_table

        rows = [
            [name, message.direction or "", ", ".join(message.fields), message.doc]
            for name, message in self.variant().messages.items()
        ]
        return html_table(f"{self.name} ({self.link})", ["message", "direction", "fields", ""], rows)
