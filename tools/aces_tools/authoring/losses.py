"""What a DBC says that a spec has no word for: attributes, environment variables, groups, comments of nodes.

1. Each kind is one remark, with how often it is there and the line of the first.
"""

from __future__ import annotations

import re

from aces_bus.protocol.exchange.import_dbc import read_text
from aces_bus.protocol.exchange.import_statements import split_statements
from aces_bus.protocol.exchange.problems import ImportProblem, excerpt

#: Attributes that are taken over: frame format, names, cycle time, J1939.
_TAKEN = frozenset(
    (
        *("VFrameFormat", "ProtocolType", "GenMsgCycleTime", "Baudrate"),
        *("SystemMessageLongSymbol", "SystemSignalLongSymbol", "SystemNodeLongSymbol"),
    )
)
_ATTRIBUTE = re.compile(r'\s*BA_\s+"([^"]*)"')
_KINDS = (
    (re.compile(r"\s*(EV_|ENVVAR_DATA_|EV_DATA_)\s"), "environment variables"),
    (re.compile(r"\s*SIG_GROUP_\s"), "groups of signals"),
    (re.compile(r"\s*BO_TX_BU_\s"), "further senders of messages"),
    (re.compile(r"\s*BA_REL_\s"), "attributes of relations"),
    (re.compile(r"\s*VAL_TABLE_\s"), "tables of values that no signal has"),
    (re.compile(r"\s*CM_\s+BU_\s"), "comments of nodes"),
    (re.compile(r"\s*CM_\s+EV_\s"), "comments of environment variables"),
    (re.compile(r'\s*CM_\s+"'), "comments of the whole file"),
)


def left_out(path: str) -> list[ImportProblem]:
    """Remarks about a DBC file. Raises `CallerError` when it cannot be read."""
    found: dict[str, list[int]] = {}
    for one in split_statements(read_text(path, "dbc")):
        what = ""
        if one.word == "BA_":
            attribute = _ATTRIBUTE.match(one.text)
            if attribute is not None and attribute[1] not in _TAKEN:
                what = f"the attribute {excerpt(attribute[1])}"
        else:
            what = next((kind for pattern, kind in _KINDS if pattern.match(one.text)), "")
        if what:
            found.setdefault(what, []).append(one.line)
    return [
        ImportProblem(
            where[0],
            f"{what}: not taken over" + (f" ({len(where):,} times)" if len(where) > 1 else ""),
            is_note=True,
        )
        for what, where in found.items()
    ]


__all__ = ["left_out"]
