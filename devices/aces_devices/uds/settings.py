"""The keys of an ECU in a robot file."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
from msgspec import Meta

#: How often values and codes are asked for (s).
EVERY_S, CODES_EVERY_S = 0.5, 2.0
#: How long an answer may take (s): it begins within 50 ms (P2), and has several frames.
TIMEOUT_S = 0.15
#: So many identifiers fit into a request of one frame.
AT_ONCE = 3


class UdsSettings(msgspec.Struct, frozen=True, kw_only=True):
    """The driver's own keys in a robot file."""

    identifiers: Annotated[
        dict[str, Any],
        Meta(description="a table of values: name = { identifier, type, access, unit, scale, offset, … }"),
    ] = {}
    table: Annotated[str, Meta(description="the path of a TOML file with [identifiers]")] | None = None
    every_s: Annotated[
        float, Meta(gt=0, description=f"how often values are read (s), {EVERY_S} when absent")
    ] = EVERY_S
    codes_every_s: Annotated[
        float, Meta(ge=0, description=f"how often trouble codes are read (s), {CODES_EVERY_S}; 0: never")
    ] = CODES_EVERY_S
    at_once: Annotated[
        int, Meta(ge=1, le=AT_ONCE, description="how many identifiers one request has, 1 when absent")
    ] = 1
    timeout_s: Annotated[
        float, Meta(gt=0, description=f"how long an answer may take (s), {TIMEOUT_S} when absent")
    ] = TIMEOUT_S
    session: Annotated[
        str, Meta(description="the session in which it takes what is written, extended when absent")
    ] = "extended"
    level: Annotated[
        int, Meta(ge=0, le=0x7D, description="the level, an odd number, that enable unlocks; 0: none")
    ] = 0
    routines: Annotated[
        dict[str, int], Meta(description="names of routines and their numbers: { erase = 0xFF00 }")
    ] = {}
