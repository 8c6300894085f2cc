"""What databases of messages hold that hand-written specs seldom do.

What it asks of the language: multiplexers inside multiplexers and beside each other, chosen by ranges; floats between
bytes; signals that share bits; quantities of which some values have names; bytes behind the declared ones.
"""

from __future__ import annotations

from aces_bus.protocol import (
    BitLayout,
    Enumeration,
    IdField,
    Multiplexed,
    Protocol,
    Quantity,
    bits,
    float_bits,
)

database_like = Protocol(
    "database_like", link="can", bitrate=500_000, doc="Invented, as an importer would write it."
)

Nested = database_like.message(
    "Nested",
    doc="Multiplexers inside multiplexers.",
    id=0x101,
    payload=BitLayout(
        8,
        "page" / bits(4),
        "status"
        / Multiplexed("page", range(3), Quantity(bits(8, at=8), scale=0.5, unit="V", names={"none": 255})),
        "sub" / Multiplexed("page", (3, 5, 6, 9, 11, 12, 13, 14, 15), Enumeration(bits(3, at=8), a=1, b=6)),
        "small" / Multiplexed("sub", (0, 1), bits(7, at=20, signed=True)),
        "ratio" / Multiplexed("sub", range(2, 6), float_bits(32, at=13)),
        "deep" / Multiplexed("sub", 7, bits(2, at=50, order="msb")),
        "deeper" / Multiplexed("deep", (1, 3), bits(9, at=24)),
    ),
)

Beside = database_like.message(
    "Beside",
    doc="Two multiplexers side by side.",
    id=0x102,
    payload=BitLayout(
        8,
        "left" / bits(3, signed=True),
        "right" / bits(3, at=8),
        "l1" / Multiplexed("left", (-4, -1), bits(10, at=16)),
        "l2" / Multiplexed("left", range(3), bits(6, at=20)),
        "r1" / Multiplexed("right", range(4), bits(12, at=32, order="msb")),
        "r2" / Multiplexed("right", (5, 7), float_bits(16, at=33)),
    ),
)

Shared = database_like.message(
    "Shared",
    doc="Signals that share bits.",
    id=0x103,
    payload=BitLayout(
        6,
        "all" / bits(16),
        "low" / bits(8, at=0),
        "signed" / bits(16, at=8, signed=True),
        "middle" / Quantity(bits(13, at=5, order="msb"), scale=-0.25, offset=3, unit="A"),
        "chosen" / Multiplexed("low", range(100), bits(24, at=20)),
        overlapping=True,
        trailing="trailing",
    ),
)

Floats = database_like.message(
    "Floats",
    doc="Floats in and between bytes.",
    id=0x110 + IdField("node", range(4)),
    fd=True,
    payload=BitLayout(
        21,
        "aligned" / float_bits(32, at=0),
        "motorola" / float_bits(64, at=32, order="msb"),
        "crooked" / float_bits(64, at=97),
        trailing="trailing",
    ),
)

Empty = database_like.message(
    "Empty", doc="No signals at all.", id=0x120, payload=BitLayout(0, trailing="trailing")
)

# Names with underscores, such that helpers of generated code could be taken for each other's.
A = database_like.message(
    "A",
    doc="A name that another begins with.",
    id=0x130,
    payload=BitLayout(1, "b_c" / Enumeration(bits(2), x=0, y=1)),
)
A_b = database_like.message(
    "A_b",
    doc="A name with an underscore.",
    id=0x131,
    payload=BitLayout(1, "c" / Enumeration(bits(2), z=0, w=1)),
)
