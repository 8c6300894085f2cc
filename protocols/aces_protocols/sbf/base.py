"""SBF: the protocol, its blocks, and the quantities that several blocks have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from construct import (
    Array,
    Byte,
    Bytes,
    Const,
    Construct,
    Default,
    Float32l,
    Float64l,
    GreedyBytes,
    Int16ul,
    Int32ul,
    Rebuild,
    Struct,
    len_,
    this,
)

from aces_bus.protocol import BitLayout, Crc, Enumeration, IdField, Protocol, Quantity, bits

from .examples import EXAMPLES

GUIDE = "Septentrio PolaRx5TR Reference Guide 5.5.0, chapter 4"

sbf = Protocol(
    "sbf",
    link="serial",
    baud=115_200,
    doc="Septentrio receivers: position, velocity, attitude, measurements, state.",
    source=f"{GUIDE}; mosaic-H Reference Guide 4.10.1; septentrio_gnss_driver",
)

#: Measurements of 80 satellites with five signals more fit (MeasEpoch: 20 + 5 × 12 each); the length would allow 65,532.
MAX_SIZE = 8192

_packet = sbf.framing(
    sync=b"$@",
    header=Struct("crc" / Int16ul, "block" / Int16ul, "length" / Int16ul),
    size=this.length + 0,
    multiple=4,
    max_size=MAX_SIZE,
    gap=0.5,
    check=Crc("CRC16-XMODEM", field="crc", over=slice(4, None)),
)

#: What stands for "do not use" in floats (§4.1.7).
DO_NOT_USE = -2e10

TIME = (
    "tow" / Quantity(Int32ul, unit="ms", unknown=[0xFFFF_FFFF], doc="Time of the GPS week."),
    "week" / Quantity(Int16ul, unknown=[0xFFFF], doc="GPS week, continuous."),
)


def sbf_block(
    name: str,
    number: int,
    *fields: Construct,
    is_padded: bool = True,
    revisions: range = range(8),
    **more: Any,
) -> None:
    """Declare a block of these revisions. In its padding, and behind, receivers of a later revision put fields;
    `is_padded=False`: nothing follows its last field."""
    more.setdefault("source", GUIDE)
    tail = ("padding" / Default(GreedyBytes, b""),) if is_padded else ()
    _packet(
        name,
        direction="from device",
        match={"block": IdField("revision", revisions) << 13 | number},
        payload=Struct(*TIME, *fields, *tail),
        **more,
    )


def sbf_revisions(
    name: str, number: int, *fields: Construct, later: Mapping[int, Sequence[Construct]], **more: Any
) -> None:
    """Declare a block to which revisions have added fields at its end, by their number in `later`: the newest one, which
    also stands for revisions to come, as `name`, the others as `nameRevision0` and so on."""
    begins = [0, *sorted(later)]
    for at, begin in reversed([*enumerate(begins)]):
        is_newest = begin == begins[-1]
        named = name if is_newest else f"{name}Revision{begin}"
        sbf_block(
            named,
            number,
            *fields,
            *(field for revision in begins[1 : at + 1] for field in later[revision]),
            revisions=range(begin, 8 if is_newest else begins[at + 1]),
            examples=EXAMPLES.get(named, ()),
            **more,
        )


def sbf_groups(
    name: str,
    number: int,
    groups: str,
    group: Sequence[Construct],
    *between: Construct,
    inner: tuple[str, Sequence[Construct]] | None = None,
    is_padded: bool = False,
    **more: Any,
) -> None:
    """Declare a block that counts its groups and states their size: as the guide has them, and, called `…Longer`, with the
    bytes that a later revision has behind the fields of each (in `more`). `between` stands before the first group;
    `inner` are groups in each of them, by their name, which the last field of `group` counts.
    """
    size = Struct(*group).sizeof()
    stated = bytes([size]) if inner is None else bytes([size, Struct(*inner[1]).sizeof()])
    head = "count" / Rebuild(Byte, len_(this[groups]))

    def fields(is_longer: bool) -> list[Construct]:
        rest = ["more" / Default(Bytes(this._.size - size), b"")] if is_longer else []
        whole = [*group, *rest]
        if inner is not None:
            inside = [*inner[1]]
            if is_longer:
                inside.append("more" / Default(Bytes(this._._.inner_size - stated[1]), b""))
            whole.append(inner[0] / Array(this.count, Struct(*inside)))
        return whole

    sizes = ["size" / Byte, *(["inner_size" / Byte] if inner is not None else [])]
    given = {key: value for key, value in more.items() if key not in ("doc", "examples")}
    doc = f"{name} of a later revision, whose groups are longer."
    sbf_block(
        f"{name}Longer",
        number,
        head,
        *sizes,
        *between,
        groups / Array(this.count, Struct(*fields(True))),
        doc=doc,
        examples=EXAMPLES.get(f"{name}Longer", ()),
        **given,
    )
    sbf_block(
        name,
        number,
        head,
        Const(stated),
        *between,
        groups / Array(this.count, Struct(*fields(False))),
        is_padded=is_padded,
        overrides=f"{name}Longer",
        **more,
    )


def single(unit: str, doc: str = "") -> Quantity:
    """Return a single-precision number with its do-not-use value."""
    return Quantity(Float32l, unit=unit, unknown=[DO_NOT_USE], doc=doc)


def double(unit: str, doc: str = "") -> Quantity:
    """Return a double-precision number with its do-not-use value."""
    return Quantity(Float64l, unit=unit, unknown=[DO_NOT_USE], doc=doc)


def u2(unit: str, scale: float) -> Quantity:
    """Return a scaled 16-bit number with its do-not-use value."""
    return Quantity(Int16ul, unit=unit, scale=scale, unknown=[0xFFFF])


#: The kinds of position (§4.2, PVT blocks: Mode).
SOLUTIONS = {
    "none": 0, "stand_alone": 1, "differential": 2, "fixed_location": 3, "rtk_fixed": 4, "rtk_float": 5, "sbas": 6,
    "moving_base_fixed": 7, "moving_base_float": 8, "ppp": 10,
}  # fmt: skip
ERRORS = {
    "none": 0, "few_measurements": 1, "few_ephemerides": 2, "dop": 3, "residuals": 4, "no_convergence": 5, "outliers": 6,
    "export": 7, "few_corrections": 8, "no_base": 9, "not_fixed": 10, "no_datum": 17,
}  # fmt: skip
#: What a position needs: how it was found, and why it was not.
MODE = (
    "mode"
    / BitLayout(
        1,
        "solution" / Enumeration(bits(4), SOLUTIONS),
        "auto_base" / bits(1, at=6),
        "is_2d" / bits(1, at=7),
    ),
    "error" / Enumeration(Byte, ERRORS),
)
