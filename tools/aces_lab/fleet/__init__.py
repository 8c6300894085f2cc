"""Many recordings, many machines: decoded by Dask's workers into Parquet datasets, wherever fsspec reads and writes.

    from aces_lab import fleet

    run = fleet.decode("s3://logs/2026/**/*.mf4", "truck.dbc", "s3://lake/truck/", cluster="tcp://scheduler:8786")
    print(run.total["can"])
    fleet.status("s3://lake/truck/")

1. What an input gives is what one process gives: the same readers, scanners and writers.
2. An input's parts are named by its URI, its contents and the recipe (protocols and options): to decode it again writes the
   same files again. Whatever is killed, nothing is there twice, and what is missing the next run does.
3. A bad input is a line of the manifest. Only what is wrong with the call, the dataset or the cluster raises.

Needs the extra `[fleet]`, and for a store what fsspec needs for it: `s3fs`, `sshfs`, `gcsfs`, `aiohttp` (HTTP) …
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from aces_bus._lazy import lazy_names

if TYPE_CHECKING:
    from .manifest import FleetInput as FleetInput
    from .overview import FleetStatus as FleetStatus
    from .overview import status as status
    from .recipe import FleetProtocol as FleetProtocol
    from .run import FleetProgress as FleetProgress
    from .run import FleetRun as FleetRun
    from .run import decode as decode

__all__ = [
    "FleetInput",
    "FleetProgress",
    "FleetProtocol",
    "FleetRun",
    "FleetStatus",
    "decode",
    "status",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        ".manifest": "FleetInput",
        ".recipe": "FleetProtocol",
        ".run": "FleetProgress FleetRun decode",
        ".overview": "FleetStatus status",
    },
)
