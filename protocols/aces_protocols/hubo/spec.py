"""Hubo's CAN protocol, gathered: `hubo` with all its messages.

1. The order of the imports is the order of the messages: replies come after their requests.
2. Each message is declared in the module named here and is found as `hubo["Name"]`.

Facts: each board has a number (`board`), each sensor another (`sensor` = board − 0x2F). Commands share the identifier
0x001; data has a base plus one of the two numbers. Firmware generations share identifiers and differ in payloads, and a
frame does not say which it is of (dialect), how many channels its board has (`boards`), or which request it answers
(`parameters`, `sensors`).
"""

from __future__ import annotations

from . import commands as commands
from . import d15 as d15
from . import motion as motion
from . import parameters as parameters
from . import replies as replies
from . import sensors as sensors
from . import settings as settings
from . import status as status
from .base import hubo as hubo
