"""Badges of protocols: what was proved of them, when and with what; stale once generated text or declaration change.

The badges of shipped protocols are in `proved.json` beside their specs; `make prove` writes it.
"""

from __future__ import annotations

import hashlib
import re
from importlib.util import find_spec
from pathlib import Path

import msgspec
from msgspec.structs import replace

from aces_bus.protocol import Protocol


class Badge(msgspec.Struct, frozen=True):
    """What was proved of a protocol, counted by status: its messages, that they are apart and reachable, its scanners."""

    summary: str
    apart: str
    date: str
    version: str
    z3: str
    #: Of `protocol_hash`, when it was proved.
    hash: str
    streams: str = ""


def badges_path() -> Path | None:
    """Return the file of the badges of shipped protocols; None where the catalogue is not installed."""
    found = find_spec("aces_protocols")
    return None if found is None or found.origin is None else Path(found.origin).parent / "proved.json"


def read_badges() -> dict[str, Badge]:
    """Return the badges of shipped protocols, by name."""
    path = badges_path()
    if path is None or not path.exists():
        return {}
    return msgspec.json.decode(path.read_bytes(), type=dict[str, Badge])


def protocol_hash(protocol: Protocol) -> str:
    """Return a hash of what was proved: the text of all decoders, the plans of all messages, and the configurations."""
    from aces_bus.protocol.generate.decode import Decoder
    from aces_bus.protocol.generate.load import print_decoder

    digest = hashlib.sha256(repr(sorted(protocol.configurations.items())).encode())
    for message in protocol.declared:
        # Where and in which words changes no meaning; what all fields are together follows from each of them.
        plan = replace(message.plan, place="", doc="", all_fields=None)
        pattern = [(c.name, c.shift, sorted(c.values)[:4096]) for c in message.identifier.captures]
        shown = re.sub(r"(place|doc)='[^']*'|, all_fields=None", "", repr(plan))
        digest.update(f"{shown} {message.identifier.constant} {pattern}".encode())
        digest.update(print_decoder(Decoder(plan, raw=False)).encode())
    return digest.hexdigest()[:16]


def badge_text(protocol: Protocol) -> str:
    """Return what was proved of a protocol, in one line: `proved` or `stale`, or that nothing was."""
    found = read_badges().get(protocol.name)
    if found is None:
        return "not proved: aces spec prove"
    streams = f"; streams: {found.streams}" if found.streams else ""
    what = f"{found.summary}{streams} ({found.date}, aces-bus {found.version}, z3 {found.z3})"
    if found.hash != protocol_hash(protocol):
        return f"stale: changed since this was proved: {what}; run aces spec prove {protocol.name}"
    return what
