"""Scanners for any link."""

from __future__ import annotations

import typing
from collections.abc import Callable, Sequence
from threading import Lock, current_thread
from typing import Any

from ...errors import CallerError
from ..counts import ScanCounts
from ..declare.message import GivenWay
from ..declare.protocol import DeclaredProtocol, Variant
from ..record import Record
from .can import CanScanner


class Scanner(typing.Protocol):
    """What every scanner does; `CanScanner` and `StreamScanner` say how.

    A scanner is for one thread: it holds no lock, and two calls at once mix up its buffer and its counts. Give each thread a
    scanner of its own, or hand what it receives over through a queue; `check_thread` finds where that is not so.
    """

    @property
    def link(self) -> str:
        """`can`, `serial` or `datagram`."""
        ...

    @property
    def variants(self) -> tuple[Variant, ...]:
        """Variants to look for, in order of precedence."""
        ...

    def feed(self, traffic: Any, /) -> list[Record]:
        """Return the records of frames (CAN) or of bytes (streams), in order."""
        ...

    @property
    def counts(self) -> ScanCounts:
        """Number of bytes or frames so far by their outcome."""
        ...

    def idle(self, time: float | None = None) -> list[Record]:
        """Give up what is incomplete, because the line fell silent; return the records that this decides."""
        ...

    def close(self) -> list[Record]:
        """End the capture; return the last records."""
        ...

    def reset(self) -> None:
        """Forget everything seen, counts included: as if just made."""
        ...

    def sent(self, packet: Any, /) -> None:
        """Note our own transmission: a request that replies may need."""
        ...


def make_scanner(
    variants: Sequence[Variant],
    *,
    direction: GivenWay | None = None,
    include_unknown: bool = False,
    raw: bool = False,
    check_thread: bool = False,
) -> Scanner:
    """Make a scanner for all protocols of a wire: each byte and frame has one owner, the first in the order given.

    `direction` limits it to messages "to device" or "from device" (in short "to", "from"); "both" pairs requests and
    replies. Without a direction, CAN frames that only it would tell apart are unknown. With `include_unknown`, what is
    not decoded comes as `Unknown` among the records. `raw` leaves out units, scales and names.

    A variant bound to a channel (`variant.on("can0")`) decides about that channel's frames only.

    A scanner is for one thread. With `check_thread` a call that comes while another is under way raises `CallerError`, at
    the cost of a lock a call; without it such calls give wrong records and counts.

    Raises `CallerError` for what is not a list of variants, when the protocols are not of one kind of link, for a word that
    is not a direction, or when a protocol on a stream needs a direction and none is given.
    """
    _refuse_what_is_no_variant(variants)
    if not variants:
        raise CallerError("a scanner needs at least one protocol")
    links = {"can" if v.link == "can" else "stream" for v in variants}
    if len(links) > 1:
        named = ", ".join(f"{v.name} ({v.link})" for v in variants)
        raise CallerError(f"one wire carries one kind of link; these are of several: {named}")
    if direction is None:
        for variant in variants:
            clash = variant.direction_conflict
            if clash is not None and variant.link != "can":
                raise CallerError(
                    f"{variant.name}: bytes alone do not tell {clash[0].name} from {clash[1].name};"
                    " say the direction: 'to device', 'from device' or 'both'"
                )
    made = _made(variants, links, direction=direction, include_unknown=include_unknown, raw=raw)
    if check_thread:
        _guard(made)
    return made


def _refuse_what_is_no_variant(given: Any) -> None:
    """Raise `CallerError` for a protocol, a name or a single variant in place of several variants."""
    is_one = isinstance(given, (str, DeclaredProtocol, Variant))
    wrong = [one for one in ([given] if is_one else given) if is_one or not isinstance(one, Variant)]
    if wrong:
        raise CallerError(
            f"make_scanner takes a list of variants, not {type(wrong[0]).__name__}:"
            " make_scanner([load_protocol('hubo').variant()])"
        )


def _made(variants: Sequence[Variant], links: set[str], **more: Any) -> Scanner:
    if links == {"can"}:
        if any(variant.channel is not None for variant in variants):
            from .channels import ChannelScanner

            return ChannelScanner(variants, **more)
        return CanScanner(variants, **more)
    from .stream import StreamScanner

    return StreamScanner(variants, **more)


def _guard(scanner: Scanner) -> None:
    """Have every call that moves the scanner on look whether another one is under way."""
    lock = Lock()
    under_way = ""

    def guarded(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **more: Any) -> Any:
            nonlocal under_way
            if not lock.acquire(blocking=False):
                raise CallerError(
                    f"{name} was called while {under_way} was under way: a scanner is for one thread;"
                    " give each thread one of its own, or hand what it receives over through a queue"
                )
            try:
                under_way = f"{name} in {current_thread().name}"
                return method(*args, **more)
            finally:
                lock.release()

        return call

    for name in ("feed", "feed_table", "datagram", "idle", "close", "sent", "reset"):
        method = getattr(scanner, name, None)
        if method is not None:
            scanner.__dict__[name] = guarded(name, method)
