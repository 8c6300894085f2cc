"""How recordings of the lab's formats begin: magic numbers, and first lines that are one format's own."""

from __future__ import annotations

import re

from aces_bus.recordings.beginnings import has_line

MDF = (b"MDF     ", b"UnFinMF ")
#: The header of SavvyCAN's CSV; the group is there where a column says which way frames went.
GVRET = rb"\s*Time ?Stamp,ID,Extended,(Dir,)?Bus,LEN(?:,D[0-9]{1,2})*,?\s*(?:\n|\Z)"

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


def is_id_csv(head: bytes) -> bool:
    """Return whether the first line is a header that names an identifier and one more thing of a frame."""
    from .id_csv import roles_of_header

    roles = roles_of_header(head)
    return "id" in roles and len(roles) > 1
