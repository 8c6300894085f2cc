"""Badges of protocols: what was proved of them, when and with what; stale once generated text or declaration change.

The badges of shipped protocols are in `proved.json` beside their specs; `make prove` writes it.
"""

from __future__ import annotations

import hashlib
import json
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from aces_bus.protocol import Protocol


def badges_path() -> Path | None:
    """Return the file of the badges of shipped protocols; None where the catalogue is not installed."""
    found = find_spec("aces_protocols")
    return None if found is None or found.origin is None else Path(found.origin).parent / "proved.json"


def read_badges() -> dict[str, Any]:
    """Return the badges of shipped protocols, by name."""
    path = badges_path()
    if path is None or not path.exists():
        return {}
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def protocol_hash(protocol: Protocol) -> str:
    """Return a hash of what was proved: the text of all decoders, the plans of all messages, and the configurations."""
    from aces_bus.protocol.generate.decode import Decoder
    from aces_bus.protocol.generate.load import print_decoder

    digest = hashlib.sha256(repr(sorted(protocol.configurations.items())).encode())
    for message in protocol.declared:
        plan = replace(message.plan, place="", doc="")  # where and in which words changes no meaning
        pattern = [(c.name, c.shift, sorted(c.values)[:4096]) for c in message.identifier.captures]
        shown = re.sub(r"(place|doc)='[^']*'", "", repr(plan))
        digest.update(f"{shown} {message.identifier.constant} {pattern}".encode())
        digest.update(print_decoder(Decoder(plan, raw=False)).encode())
    return digest.hexdigest()[:16]


def badge_text(protocol: Protocol) -> str:
    """Return what was proved of a protocol, in one line: `proved` or `stale`, or that nothing was."""
    found = read_badges().get(protocol.name)
    if found is None:
        return "not proved: aces spec prove"
    what = f"{found['summary']} ({found['date']}, aces-bus {found['version']}, z3 {found['z3']})"
    if found["hash"] != protocol_hash(protocol):
        return f"stale: changed since this was proved: {what}; run aces spec prove {protocol.name}"
    return what
