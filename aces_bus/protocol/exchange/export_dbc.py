"""A variant as a DBC file: what `dbc_signals` says of it, written through cantools' database objects.

1. Losses are written into the comments of the messages, or of the node `Host`.
2. The attribute `LENGTHS` lists lengths of frames that differ, and the importer takes the shorter frames, too.
3. Text is made fit for the format here: names are C names, no quote or backslash ends a string.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from ...errors import CallerError
from ..declare.protocol import Variant
from .dbc_signals import EXPANDED, DbcSignal, Identified, identified
from .import_build import LENGTHS
from .problems import Loss, ProblemText

#: The attribute VFrameFormat: by (29 bits, CAN FD), and of a J1939 parameter group.
_FORMATS = [
    *("StandardCAN", "ExtendedCAN", "reserved", "J1939PG", *["reserved"] * 10),
    *("StandardCAN_FD", "ExtendedCAN_FD"),
]
_FORMAT = {(False, False): 0, (True, False): 1, (False, True): 14, (True, True): 15}


def print_dbc(
    variant: Variant, *, only: Collection[str] = (), expand: int = EXPANDED
) -> tuple[str, list[Loss]]:
    """Return the text of a DBC file, and what it does not say.

    `only` and `expand` are those of `identified`. Raises `CallerError` for a link that is not CAN, for a variant
    of which nothing can be said.
    """
    if variant.link != "can":
        raise CallerError(f"{variant.label}: a DBC is for CAN; the link of this protocol is {variant.link}")
    from cantools.database.can import Bus, Node
    from cantools.database.can.database import Database
    from cantools.database.can.formats.dbc import DbcAttributeDefinition, DbcSpecifics

    messages, losses = identified(variant, only=only, expand=expand)
    if not messages:
        reasons = list(dict.fromkeys(map(str, losses)))
        more = f", and {len(reasons) - 1} more" if len(reasons) > 1 else ""
        why = f": {reasons[0]}{more}" if reasons else ""
        raise CallerError(f"{variant.label}: nothing of it can be said in a DBC{why}")
    specifics: Any = DbcSpecifics()
    definition: Any = None
    if any(message.is_fd or message.is_j1939 for message in messages):
        definition = DbcAttributeDefinition(
            "VFrameFormat", default_value=_FORMATS[0], kind="BO_", type_name="ENUM", choices=_FORMATS
        )
        specifics.attribute_definitions["VFrameFormat"] = definition
    lengths: Any = None
    if any(message.lengths for message in messages):
        lengths = DbcAttributeDefinition(LENGTHS, default_value="", kind="BO_", type_name="STRING")
        specifics.attribute_definitions[LENGTHS] = lengths
    made = [_message(message, losses, definition, lengths) for message in messages]
    there = {name for message in messages for name in message.members}
    about = [f"Made from {variant.label}.", *_not_said(loss for loss in losses if loss.message not in there)]
    bitrate = variant.protocol.bitrate
    database: Any = Database(
        made,
        [Node("Host", _text("\n".join(about)), None), Node("Device", None, None)],
        [Bus("CAN", baudrate=bitrate)] if bitrate is not None else [],
        _text(variant.label),
        specifics,
        strict=False,
    )
    return str(database.as_dbc_string()).replace("\r\n", "\n"), losses


def _message(message: Identified, losses: Sequence[Loss], definition: Any, lengths: Any) -> Any:
    from cantools.database.can import Message
    from cantools.database.can.formats.dbc import DbcAttribute, DbcSpecifics

    specifics: Any = DbcSpecifics()
    kind = 3 if message.is_j1939 else _FORMAT[message.is_extended, message.is_fd]
    if definition is not None:
        specifics.attributes["VFrameFormat"] = DbcAttribute(kind, definition)
    if message.lengths:
        specifics.attributes[LENGTHS] = DbcAttribute(" ".join(map(str, message.lengths)), lengths)
    mine = [loss for loss in losses if loss.message in message.members]
    if len(message.members) == 1:
        mine = [Loss("", loss.field, loss.reason) for loss in mine]
    return Message(
        message.id,
        message.name,
        message.size,
        [_signal(signal, message) for signal in message.signals],
        comment=_text("\n".join(filter(None, [message.comment, *_not_said(mine)]))) or None,
        senders=[message.sender] if message.sender else None,
        dbc_specifics=specifics,
        is_extended_frame=message.is_extended,
        is_fd=message.is_fd,
        protocol="j1939" if message.is_j1939 else None,
        strict=False,
    )


def _not_said(losses: Iterable[Loss]) -> list[str]:
    return [f"Not as in the spec: {loss}." for loss in losses]


def _signal(signal: DbcSignal, message: Identified) -> Any:
    from cantools.database.can import Signal as Made
    from cantools.database.conversion import BaseConversion

    receivers = {"Host": ["Device"], "Device": ["Host"]}.get(message.sender)
    names: Any = {value: _text(name, is_short=True) or "?" for value, name in signal.names.items()}
    return Made(
        signal.name,
        signal.start,
        signal.width,
        "big_endian" if signal.is_big else "little_endian",
        signal.is_signed,
        conversion=BaseConversion.factory(signal.scale, signal.offset, names or None, signal.is_float),
        minimum=signal.low,
        maximum=signal.high,
        unit=_text(signal.unit, is_short=True) or None,
        comment=_text(signal.comment) or None,
        receivers=receivers,
        is_multiplexer=signal.is_selector,
        multiplexer_ids=list(signal.when[1]) if signal.when is not None else None,
        multiplexer_signal=signal.when[0] if signal.when is not None else None,
    )


def _text(text: str, *, is_short: bool = False) -> str:
    """Return a text as a string of a DBC: `is_short` on one line and without quotes (units, names of values)."""
    text = re.sub(r'\\+(?="|$)', "/", ProblemText.clean(text))
    return " ".join(text.replace('"', "'").replace("\\", "/").split()) if is_short else text
