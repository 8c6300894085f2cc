"""Where tasks run: in this process, in processes of this machine, or on a Dask cluster.

    here                      this process, one input after the other
    local:4                   four processes of this machine
    tcp://scheduler:8786      a Dask scheduler; tls:// with its certificates (docs/fleets.md)

1. Dask's scheduler and workers run what clients send them. What is started here listens on 127.0.0.1 alone, and takes only
   clients with the key that it makes for itself.
2. A task is a function of `work` by its name, with data. A worker that dies has its tasks done by another.
"""

from __future__ import annotations

import logging
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from types import ModuleType
from typing import Any, NamedTuple

from aces_bus.errors import CallerError
from aces_bus.loopback import is_loopback

#: Seconds that a cluster may take until it has a worker.
WORKERS_S = 120
#: Tasks that wait at each thread of a worker: there is always a next one.
WAITING = 2

#: What Dask measures of itself all the time is not looked at here, and takes 7 % of a core of a process that waits.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "1h",
    "distributed.admin.system-monitor.interval": "5s",
}

_LOCAL = re.compile(r"local(?::([0-9]+))?")


class Workers(ABC):
    """Who takes tasks. `submit` gives what `done` says is finished; `capacity` is how many may be under way."""

    capacity = 1
    #: How many work at once.
    width = 1

    @abstractmethod
    def submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Have a function of `work` called; arguments may be what other submissions gave."""

    @abstractmethod
    def watch(self, task: Any) -> None:
        """Have `done` give this future when it is finished."""

    @abstractmethod
    def done(self) -> Any:
        """Return the next watched one that is finished."""

    @abstractmethod
    def result(self, task: Any) -> Any:
        """Return what it gave; raises what it raised."""

    @abstractmethod
    def close(self) -> None:
        """Take no more tasks."""


class _Called(NamedTuple):
    """What a call in this process raised, or gave."""

    error: Exception | None
    value: Any


class Here(Workers):
    """This process."""

    def __init__(self) -> None:
        self._finished: list[Any] = []

    def submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return _Called(
                None,
                call(
                    *(
                        self.result(argument) if isinstance(argument, _Called) else argument
                        for argument in arguments
                    )
                ),
            )
        except Exception as error:
            return _Called(error, None)

    def watch(self, task: Any) -> None:
        self._finished.append(task)

    def done(self) -> Any:
        return self._finished.pop(0)

    def result(self, task: Any) -> Any:
        called: _Called = task
        if called.error is not None:
            raise called.error
        return called.value

    def close(self) -> None:
        self._finished.clear()


class DaskWorkers(Workers):
    """A Dask cluster: of this machine when `processes` says how many, else the one at `address`, or of a client."""

    def __init__(self, *, processes: int = 0, address: str = "", client: Any = None) -> None:
        distributed = load_distributed()
        if address.startswith("tls://"):
            _check_certificates(address)
        self._cluster: Any = None
        self._owns = client is None
        try:
            if processes:
                with import_module("dask").config.set(QUIET):
                    self._cluster = distributed.LocalCluster(
                        n_workers=processes,
                        threads_per_worker=1,
                        host="127.0.0.1",
                        dashboard_address="127.0.0.1:0",
                        security=True,
                        silence_logs=logging.CRITICAL,
                    )
                address = self._cluster
            self.client = distributed.Client(address, set_as_default=False) if client is None else client
            self.client.wait_for_workers(1, timeout=WORKERS_S)
            threads = sum(self.client.nthreads().values())
        except (OSError, TimeoutError, ValueError, ImportError) as error:
            self.close()
            where = f"local:{processes}" if processes else address or "the client's cluster"
            raise CallerError(f"{where}: no worker answers: {error}") from error
        self.width = max(1, threads)
        self.capacity = self.width * (1 + WAITING)
        self._under_way = distributed.as_completed(loop=self.client.loop)

    def submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        return self.client.submit(call, *arguments, pure=False)

    def watch(self, task: Any) -> None:
        self._under_way.add(task)

    def done(self) -> Any:
        return next(self._under_way)

    def result(self, task: Any) -> Any:
        return task.result()

    def close(self) -> None:
        for client in (self.client if self._owns and hasattr(self, "client") else None, self._cluster):
            if client is not None:
                with suppress(Exception):
                    client.close()


def load_distributed() -> ModuleType:
    """Return the library; raises `CallerError` with how to install it."""
    try:
        import distributed
    except ImportError as missing:
        raise CallerError(
            f"clusters need dask: pip install 'aces-bus[fleet]' ({missing}); --cluster here needs none"
        ) from missing
    return distributed


def _check_certificates(address: str) -> None:
    """Raise `CallerError` where Dask has no certificates to show."""
    config = import_module("dask").config
    for name in ("ca-file", "client.cert"):
        if not config.get(f"distributed.comm.tls.{name}", None):
            variable = f"DASK_DISTRIBUTED__COMM__TLS__{name.upper().replace('-', '_').replace('.', '__')}"
            raise CallerError(f"{address}: needs certificates, and {variable} is not set (docs/fleets.md)")


def open_workers(cluster: Any) -> Workers:
    """Open the workers that `cluster` names: "here", "local:4", an address of a scheduler; or a client of Dask. Raises
    `CallerError`.
    """
    if cluster is None or cluster == "here":
        return Here()
    if not isinstance(cluster, str):
        return DaskWorkers(client=cluster)
    if found := _LOCAL.fullmatch(cluster):
        number = int(found[1]) if found[1] else os.cpu_count() or 1
        if not number:
            raise CallerError(f"{cluster}: how many processes? local:4, or here for this one")
        return DaskWorkers(processes=number)
    if "://" not in cluster:
        raise CallerError(
            f"{cluster!r} is not a cluster; write here, local:4, tcp://HOST:8786 or tls://HOST:8786"
        )
    return DaskWorkers(address=cluster)


def exposure(cluster: Any) -> str | None:
    """Return a warning for a scheduler that other machines can reach, as they could run programs on its workers; else
    None.
    """
    address = (
        cluster if isinstance(cluster, str) else getattr(getattr(cluster, "scheduler", None), "address", "")
    )
    scheme, found, rest = address.partition("://")
    if not found or scheme in ("tls", "inproc", "wss"):
        return None
    host = rest.rpartition(":")[0].strip("[]") or rest
    if is_loopback(host):
        return None
    return (
        f"{address} is not tls://: all that reach this scheduler can run programs on its workers and read their traffic"
        " (docs/fleets.md shows certificates)"
    )
