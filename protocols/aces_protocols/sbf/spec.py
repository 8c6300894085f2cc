"""SBF, the binary protocol of Septentrio receivers, gathered: `sbf` with its usual blocks.

1. A block begins with `$@`, a CRC of all behind it, the block's number (13 bits) and revision (3 bits), and its length,
   a multiple of 4. `revision` is a field of the record.
2. Each field that may be not available has a value that says so (the guide's "do-not-use"): it is None here.
3. Receivers of a later revision put fields into the padding and behind: they are kept in `padding`. PVT blocks of
   revisions 0 and 1 are shorter, and messages of their own.

Sources: Septentrio, PolaRx5TR Reference Guide, firmware 5.5.0, chapter 4 (blocks, units, do-not-use values); mosaic-H
Reference Guide, firmware 4.10.1 (attitude, time, quality); septentrio-gnss/septentrio_gnss_driver `sbf_blocks.hpp` and
`msg/*.msg` (the inertial unit and external sensors).
"""

from __future__ import annotations

from . import attitude as attitude
from . import position as position
from . import state as state
from .base import sbf as sbf
