"""UBX, the binary protocol of u-blox receivers, gathered: `ubx` with all its messages, in the order of the imports.

1. A poll has the group and number of its answer and no payload: the direction tells them apart, or their length.
2. A setting is answered by `Ack` or `Nak` with its group and number; nothing else is.
3. A number that the receiver says it does not know is not unknown here: `valid`, `flags` and `flags3` say it, as in the
   sheet, and whoever reads a record has to look.

Source: semuconsulting/pyubx2 `ubxtypes_get.py`, `ubxtypes_set.py`, `ubxtypes_decodes.py`; the kinds of ESF-MEAS are general
knowledge. What is other than there: the README.
"""

from __future__ import annotations

from . import navigation as navigation
from . import sensors as sensors
from . import settings as settings
from .base import ubx as ubx
