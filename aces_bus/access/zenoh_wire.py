"""What zenoh is asked for: sessions with stated endpoints, keys, messages, and threads that hear.

1. No session searches the network, and none is left open when a program ends.
2. A message is decoded as what it has to be, or not at all.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Any

import msgspec

from ..errors import CallerError

ENDPOINT = "tcp/127.0.0.1:7447"
#: Bytes of a message: 2,000 states.
MOST_BYTES = 1 << 18
MOST_STATES = 2_000
#: Messages that wait to be taken, at most.
WAITING = 64
#: How long an answer is waited for at first, and twice as long each time up to the last (s): the first question is often
#: asked before the way is known.
ANSWER_S, MOST_ANSWER_S = 0.1, 2.0
Options = Mapping[str, Any]


class StateValues(msgspec.Struct):
    """One cycle of a publisher: by state the value (None where unknown) and its instant."""

    session: int
    now: int
    states: dict[str, tuple[float | None, int | None]]


class StateAbout(msgspec.Struct):
    """What a state is."""

    unit: str = ""
    writable: bool = False
    stale_after_s: float | None = None


class AboutStates(msgspec.Struct):
    """What a publisher publishes."""

    session: int
    rate_hz: float
    clock: str
    states: dict[str, StateAbout]
    takes: bool = False


def zenoh() -> Any:
    """The library; `CallerError` naming the extra when it is missing."""
    try:
        import zenoh as library
    except ImportError as missing:
        raise CallerError(
            f"zenoh needs eclipse-zenoh: pip install 'aces-bus[zenoh]' ({missing})"
        ) from missing
    return library


def open_session(listen: Iterable[str], connect: Iterable[str], options: Options) -> Any:
    """A session with these endpoints and no others; raises `CallerError` when that cannot be."""
    library = zenoh()
    told = {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/exit_on_failure": False,
        "connect/timeout_ms": 0,
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5},
        **options,
    }
    try:
        config = library.Config()
        for key, value in told.items():
            config.insert_json5(key, json.dumps(value))
        return library.open(config)
    except library.ZError as error:
        why = " ".join(str(error).partition(" at /")[0].split()).removeprefix("Json5Err(Message { msg: ")
        raise CallerError(f"zenoh at {', '.join([*listen, *connect])}: {why[:300]}") from None


def subscribe(declare: Callable[..., Any], key: str, take: Callable[[Any], None]) -> threading.Thread:
    """Have `take` called with all that comes at a key, until the session is closed; the oldest of too many is left out.

    On a thread of our own: a program that ends with one of the library's (eclipse-zenoh 1.10) does not end.
    """
    channel = declare(key, zenoh().handlers.RingChannel(WAITING))

    def run() -> None:
        with suppress(Exception):  # the library's own kind: the session is closed
            for one in channel:
                take(one)

    thread = threading.Thread(target=run, name=f"zenoh {key}", daemon=True)
    thread.start()
    return thread


def closed(session: Any, threads: list[threading.Thread]) -> None:
    """Close a session, and let what hears it end: a thread inside the library must not outlive the interpreter."""
    session.close()
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(2.0)
    threads.clear()


def robot_key(robot: str) -> str:
    """The beginning of a robot's keys; raises `CallerError` for a name that cannot be in one."""
    if not robot or len(robot) > 100 or set(robot) & set("*$?#/ ") or not robot.isprintable():
        raise CallerError(
            f"{robot!r} cannot be a robot's name in zenoh; say robot=, without * $ ? # / and blanks"
        )
    return f"aces/{robot}"


def decoded(decode: Callable[[bytes], Any], sample: Any) -> Any:
    """A message, or None."""
    try:
        payload = sample.payload
        if len(payload) > MOST_BYTES:
            return None
        return decode(bytes(payload))
    except Exception:  # the library's own kinds too
        return None
