"""What keeps a whole packet or frame, whose head is some message's, from being that message."""

from __future__ import annotations

from collections.abc import Sequence

from ...frames import Frame
from ..declare.message import GivenWay, Message
from ..declare.protocol import Variant
from ..record import Meta, Unknown
from .tracer import Tracer


def why_unknown(item: Unknown, variants: Sequence[Variant], *, direction: GivenWay | None = None) -> str:
    """Return which messages an `unknown` item came nearest to, and what is another in it: `Light: byte 3 07, not 08`.

    Empty without variants, where its identifier or head is no message's, where it hangs on a request, and for what is
    malformed or skipped.
    """
    if item.reason != "unknown":
        return ""
    meta = item.meta
    tracer = Tracer(variants, direction=direction)
    if not tracer.templates:
        return ""
    if meta.identifier is not None:
        frame = Frame(
            meta.identifier,
            meta.raw,
            is_extended_id=meta.extended,
            is_remote_frame=meta.remote,
            is_fd=meta.fd,
        )
        attempts = tracer.explain_frames([frame])
    else:
        attempts = tracer.explain_stream(meta.raw)[:1]
    near = {template.name for template in tracer.templates if _has_head(template.message, meta)}
    died = [
        death
        for attempt in attempts
        for step in attempt.steps
        for death in step.died
        if death.template in near
    ]
    return "; ".join(f"{death.template}: {death.why} {death.detail}" for death in died)


def _has_head(message: Message, meta: Meta) -> bool:
    """Return whether identifier or framing, and all fields of the head, are those of a message."""
    data, framing = meta.raw, message.framing
    if framing is not None:
        try:
            data = framing.logical(data)
        except ValueError:
            return False
        if not data.startswith(framing.sync):
            return False
    elif message.identifier.match(meta.identifier or 0) is None:
        return False
    return all(
        head.pattern is None or head.pattern.match(head.number(data)) is not None
        for head in message.heads_written
        if head.offset + head.size <= len(data)
    )


__all__ = ["why_unknown"]
