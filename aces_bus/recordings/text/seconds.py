"""Many seconds at once as the integer nanoseconds that their decimal digits say.

1. The result is that of `frame_table.to_ns`, for every float.

Six decimals name a float below 2³² s, and nine one below 2²², without a doubt: floats stand closer there than such decimals.
So whatever comes back from its rounded decimals is these decimals; only what does not is worth its digits being printed.
"""

from __future__ import annotations

import numpy as np

from ...frame_table import Ints, to_ns


def ns_of(seconds: Ints) -> Ints:
    """int64 nanoseconds of float64 seconds; `NO_TIME` where they are no instant.

    >>> ns_of(np.array([1436509052.249713, 0.000000001, -1.5])).tolist()
    [1436509052249713000, 1, -1500000000]
    """
    size = np.abs(seconds)
    is_early = size < float(1 << 32)
    safe = np.where(is_early, seconds, 0.0)
    micro = np.rint(safe * 1e6)
    ns = micro.astype(np.int64) * 1000
    rest = np.flatnonzero(~(is_early & (micro / 1e6 == seconds)))
    if len(rest):
        small = np.where(size[rest] < float(1 << 22), seconds[rest], 0.0)
        nano = np.rint(small * 1e9)
        ns[rest] = nano.astype(np.int64)
        rest = rest[~((size[rest] < float(1 << 22)) & (nano / 1e9 == seconds[rest]))]
        ns[rest] = [to_ns(value) for value in seconds[rest].tolist()]
    return ns
