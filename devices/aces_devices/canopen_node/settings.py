"""The keys in a robot file that every CANopen node's driver has."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta


class NodeSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Of the node's life, and of what it does without its host."""

    heartbeat_ms: Annotated[
        int, Meta(ge=0, description="the node's heartbeat (ms), 500 when absent; 0 leaves it as it is")
    ] = 500
    watchdog_ms: Annotated[
        int,
        Meta(
            ge=0,
            le=0xFFFF,
            description=(
                "how long a node that is enabled, or whose outputs are set, goes on without the host's heartbeat, where its"
                " file has object 1016 (ms), 500 when absent; 0: for ever"
            ),
        ),
    ] = 500
    host_node: Annotated[
        int, Meta(ge=1, le=127, description="the node number of the host's heartbeat, 127 when absent")
    ] = 127
    sdo_timeout_s: Annotated[
        float, Meta(gt=0, description="how long an SDO answer may take (s), 0.3 when absent")
    ] = 0.3
