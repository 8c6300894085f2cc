"""How recordings of the lab's formats begin: magic numbers, and first lines that are one format's own."""

from __future__ import annotations

import re

from aces_bus.recordings.beginnings import has_line

BLF = b"LOGG"
MDF = (b"MDF     ", b"UnFinMF ")
#: Byte order, and nanoseconds of a unit of the time stamps' fractions.
PCAP: dict[bytes, tuple[str, int]] = {
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\x3c\x4d": (">", 1),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
}
#: The header of SavvyCAN's CSV; the group is there where a column says which way frames went.
GVRET = rb"\s*Time ?Stamp,ID,Extended,(Dir,)?Bus,LEN(?:,D[0-9]{1,2})*,?\s*(?:\n|\Z)"

is_trc = has_line(
    rb"\A\s*;(?:\$FILEVERSION|#{20})|^[ \t]*[0-9]{1,12}\)[ \t]+[0-9]+(?:\.[0-9]+)?[ \t]+"
    rb"(?:(?:[0-9][ \t]+)?(?:Rx|Tx|Warng|Error)[ \t]+)?[0-9A-F]{4,8}[ \t]",
    re.MULTILINE,
)
is_asc = has_line(
    rb"^[ \t]*(?:date\s+\w{2,}.{0,16}?\s\d|base\s+(?:hex|dec)\b|begin\s+triggerblock\b"
    rb"|[0-9]{1,9}\.[0-9]{1,9}[ \t]+(?:[0-9]{1,5}[ \t]+(?:[0-9A-Fa-f]{1,8}[xX]?[ \t]+[RT]x[ \t]+[dr]\b|ErrorFrame\b)"
    rb"|CANFD[ \t]+[0-9]+[ \t]+[RT]x[ \t]))",
    re.IGNORECASE | re.MULTILINE,
)
is_busmaster = has_line(
    rb"\A\s*-?\*\*\*BUSMASTER Ver|^[0-9]{1,4}:[0-9]{1,2}:[0-9]{1,2}:[0-9]{3,4} [RT]x [0-9]{1,3} "
    rb"(?:0x)?[0-9A-Fa-f]{1,8} [sx]r?(?:-fd)? [0-9]{1,2}\b",
    re.MULTILINE | re.IGNORECASE,
)
is_crtd = has_line(
    rb"^[ \t]*[0-9]{1,12}\.[0-9]{1,9} [0-9]{0,5}(?:[RT](?:11|29) [0-9A-Fa-f]|C(?:XX|VR|EV|ER|ST)\b)",
    re.MULTILINE,
)
is_gvret = has_line(rb"\A" + GVRET, re.IGNORECASE)
is_microchip = has_line(
    rb"\A\s*(?://[^\n]*\n\s*)?Microchip Technology|"
    rb"^[0-9]{1,12}(?:\.[0-9]{1,6})?;[RT]X;(?:0x)?[0-9A-Fa-f]{1,8}x?;[0-9]{1,2};",
    re.MULTILINE | re.IGNORECASE,
)


def is_pcapng(head: bytes) -> bool:
    """Return whether these are the first bytes of a pcapng file."""
    return head[:4] == b"\n\r\r\n" and head[8:12] in (b"\x1a\x2b\x3c\x4d", b"\x4d\x3c\x2b\x1a")


def is_id_csv(head: bytes) -> bool:
    """Return whether the first line is a header that names an identifier and one more thing of a frame."""
    from .id_csv import roles_of_header

    roles = roles_of_header(head)
    return "id" in roles and len(roles) > 1
