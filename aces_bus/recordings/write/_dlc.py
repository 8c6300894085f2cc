"""The length code (DLC) of a number of data bytes (ISO 11898-1)."""

from __future__ import annotations

import numpy as np

from ...frames import FD_LENGTHS

#: uint8 by length 0…255: the lowest code that has room; 15 past 64.
DLC_OF_LENGTH = np.minimum(np.searchsorted(np.array(FD_LENGTHS), np.arange(256)), 15).astype(np.uint8)
