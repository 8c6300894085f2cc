"""The reference's decisions, each as an `Attempt`.

1. What is decided, and by what, is in the reference's items: this class asks each template afterwards, byte by byte. So
   the records explained are those of every scanner (law 2).
2. Attempts are explained when they are looked at; deciding costs what the reference costs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ...frames import AnyFrame
from ..declare.framing import Framing, Judgement, Verdict
from ..declare.message import GivenWay, Message
from ..declare.packet import frame_image
from ..declare.packet_rule import packet_frame
from ..declare.protocol import Variant
from ..declare.transport import Transport
from ..reference import PastRequest, Reference, ReferenceItem
from .attempt import Attempt, Death, FieldRead, Step, TemplateTrace
from .template import Template

#: Parts of one attempt that are explained; of longer packets the first ones and the last.
PARTS = 160


class Tracer(Reference):
    """A `Reference` that can explain itself; its records are in physical units."""

    def __init__(self, variants: Sequence[Variant], *, direction: GivenWay | None = None) -> None:
        super().__init__(variants, direction=direction)
        is_alone = len({variant.name for variant in variants}) == 1
        #: Answers that only a pending request tells from other bytes.
        self._unmarked = [message for *_, context in self.sides for message in context.unmarked]
        self.templates: list[Template] = []
        for variant, messages, _, _ in self.sides:
            for message in messages:
                name = message.name if is_alone else f"{variant.name}.{message.name}"
                self.templates.append(Template(message, name))
        messages = [template.message for template in self.templates]
        framings = {message.framing for message in messages if message.framing is not None}
        self._extras = {framing: framing.extras_of(messages) for framing in framings}

    @property
    def interesting(self) -> frozenset[str]:
        """Messages that later ones may hang on, or that hang on earlier ones."""
        found = {
            name
            for _, _, contextual, context in self.sides
            for name in (*contextual, *context.requests, *context.answers)
        }
        return frozenset(found)

    # ------------------------------------------------------------------ streams

    def explain_stream(
        self,
        data: bytes,
        *,
        idle_at: Sequence[int] = (),
        sent_at: Sequence[tuple[int, bytes]] = (),
        base: int = 0,
        wanted: range | None = None,
    ) -> list[Attempt]:
        """Return the attempts at a stream, `stream`'s decisions; `base` is the offset of its first byte.

        `wanted` are the offsets that matter: attempts that touch none of them are left out. Bytes that are skipped one
        after the other for the same reason are one attempt.
        """
        attempts: list[Attempt] = []
        for item in self.stream(data, idle_at=idle_at, sent_at=sent_at):
            start = base + item.offset
            if wanted is not None and not (start < wanted.stop and wanted.start < start + item.size):
                continue
            before = attempts[-1] if attempts else None
            is_again = before is not None and before.found.reason == "skipped" == item.reason
            if before is not None and is_again and before.start + before.run == start:
                raw = before.raw + data[item.offset : item.offset + 1]
                attempts[-1] = replace(before, run=before.run + 1, resumes=start + 1, raw=raw)
            else:
                attempts.append(self._explain(data, item, base))
        return attempts

    def _explain(self, data: bytes, found: ReferenceItem, base: int) -> Attempt:
        start, end = found.offset, found.known
        contest = _Contest(self.templates)
        sizes: dict[Framing | None, int] = {}
        size: int | None = found.size if found.message is not None else None
        offsets: list[int] = []
        at = start
        left_out = 0
        while contest.alive and at < end:
            at += 1
            prefix = data[start:at]
            is_last = at == end or (size is not None and len(prefix) == size)
            silent = at == end and found.is_silent
            framings = {t.framing for t in contest.alive if t.framing is not None}
            verdicts: dict[Framing | None, Judgement] = {
                framing: framing.judge(
                    prefix,
                    0,
                    silent=silent,
                    extras=self._extras[framing],
                    request=self._question(framing, found),
                )
                for framing in framings
            }
            sizes |= {
                framing: known for framing in framings if (known := _size_of(framing, prefix)) is not None
            }
            contest.part(
                (
                    t,
                    self._unasked(t.message, found)
                    or _death(t, prefix, verdicts[t.framing], sizes.get(t.framing), found, silent, is_last),
                )
                for t in contest.alive
            )
            offsets.append(at - start - 1)
            if is_last:
                break
            if len(offsets) == PARTS and contest.alive:
                # Of what is longer only the end is of interest: there length, end and check decide.
                reach = size or max(
                    sizes.get(t.framing) or t.framing.max_size for t in contest.alive if t.framing is not None
                )
                last = min(end, start + reach)
                left_out = max(0, last - at - 1)
                at += left_out
        lead = contest.lead(found)
        steps: list[Step] = []
        for offset, (died, living) in zip(offsets, contest.parts, strict=True):
            prefix = data[start : start + offset + 1]
            what = lead.label(offset, size if size is not None else sizes.get(lead.framing), prefix)
            read = _readings(lead, living, prefix)
            place, names = str(base + start + offset), tuple(t.name for t in living)
            steps.append(Step(place, f"{prefix[-1]:02X}", what, tuple(died), read, names))
        return Attempt(
            base + start,
            tuple(t.name for t in self.templates),
            tuple(_completed(steps, found)),
            contest.rows(
                found,
                lambda t, index: t.cell(offsets[index], size if t is lead and size else sizes.get(t.framing)),
            ),
            replace(found, offset=base + found.offset),
            base + start + found.size,
            _asked(found.request),
            left_out=left_out,
            raw=data[start : start + found.size],
        )

    def _unasked(self, message: Message, found: ReferenceItem) -> tuple[str, str] | None:
        """Say that nobody has asked for an answer that no byte marks; None where somebody has, or a byte marks it."""
        if message.name == found.message or message not in self._unmarked:
            return None
        asked = found.request.name if found.request is not None else ""
        is_awaited = any(request.message.name == asked for request in (*message.reply_to, *message.after))
        return None if is_awaited else ("request", "nobody has asked for it")

    def _question(self, framing: Framing, found: ReferenceItem) -> bytes | None:
        """Return the packet that an answer of this framing answers, where its check covers it."""
        past = found.request
        for template in self.templates if framing.covers_request and past is not None else ():
            message = template.message
            if message.framing is framing and past and message.reply_to[0].message.name == past.name:
                return message.question(past.values)
        return None

    # ------------------------------------------------------------------ frames

    def explain_frames(self, frames: Iterable[AnyFrame], first: int = 0) -> list[Attempt]:
        """Return what frames are, and why, the first one being number `first`; frames must come in their order, since
        replies hang
        on requests and packets on the frames before. A packet that a transport carried is one attempt, with its last frame.
        """
        attempts: list[Attempt] = []
        for number, frame in enumerate(frames, first):
            for found in self.frames([frame], number):
                attempts.append(self._explain_item(found, frame))
        return attempts

    def explain_end(self) -> list[Attempt]:
        """Return the frames that are in no packet when the frames end."""
        return [self._explain_item(found, found.frame) for found in self.end()]

    def _explain_item(self, found: ReferenceItem, frame: Any) -> Attempt:
        number = found.offset
        if found.transport is not None:
            frame = packet_frame(found.packet, found.frame) if found.packet else found.frame
        data = bytes(frame.data)
        image = frame_image(frame)
        if frame.is_error_frame or (found.transport is not None and not found.packet):
            return Attempt(number, (), (), (), found, number + 1, is_can=True, frame=frame, raw=data)
        contest = _Contest(self.templates)
        parts, every = _shown(frame_parts(frame, data))
        for part in parts:
            contest.part(
                (
                    t,
                    frame_death(t, frame, data, part, found.transport)
                    or (_whole_death(t, image, found) if part is parts[-1] else None),
                )
                for t in contest.alive
            )
        lead = contest.lead(found)
        steps: list[Step] = []
        for (place, text, offset), (died, living) in zip(parts, contest.parts, strict=True):
            read: tuple[FieldRead, ...] = ()
            what = {"id": "identifier", "kind": "kind of frame", "length": "length"}.get(place, "")
            if place == "id" and lead.message.identifier.match(frame.arbitration_id) is not None:
                read = captures(lead, living, frame)
            elif offset is not None:
                what = lead.label(offset, len(data), data[: offset + 1])
                if lead in living or lead.name in {d.template for d in died}:
                    read = _readings(lead, living, data[: offset + 1])
            steps.append(Step(place, text, what, tuple(died), read, tuple(t.name for t in living)))
        return Attempt(
            number,
            tuple(t.name for t in self.templates),
            tuple(_completed(steps, found)),
            contest.rows(found, lambda t, index: frame_cell(t, parts[index])),
            found,
            number + 1,
            _asked(found.request),
            is_can=True,
            frame=frame,
            left_out=every - len(parts),
            raw=data,
        )


def _shown(parts: list[Part]) -> tuple[list[Part], int]:
    """Return the parts of a frame or packet that are explained, and how many there are: of a long one the first, and
    the last.
    """
    return ([*parts[: PARTS - 1], parts[-1]] if len(parts) > PARTS else parts), len(parts)


class _Contest:
    """Which templates are still possible, part after part."""

    def __init__(self, templates: Sequence[Template]) -> None:
        self.templates, self.alive = templates, list(templates)
        #: By template, the number of the part that ruled it out, and the class of the reason.
        self.dead: dict[str, tuple[int, str]] = {}
        #: Of each part, what it ruled out, and what was possible behind it.
        self.parts: list[tuple[list[Death], list[Template]]] = []

    def part(self, reasons: Iterable[tuple[Template, tuple[str, str] | None]]) -> None:
        """Take one more part; rule out templates, each with its reason."""
        died: list[Death] = []
        for template, why in list(reasons):
            if why is not None:
                died.append(Death(template.name, *why))
                self.dead[template.name] = len(self.parts), why[0]
                self.alive.remove(template)
        self.parts.append((died, list(self.alive)))

    def lead(self, found: ReferenceItem) -> Template:
        """Return the template whose parts are named: the one that was accepted, else one that lived longest."""
        for template in self.templates:
            message = template.message
            if message.name == found.message and found.protocol in (None, message.protocol.name):
                return template
        for died, living in reversed(self.parts):
            if living:
                return living[0]
            if died:
                return next(template for template in self.templates if template.name == died[0].template)
        return self.templates[0]

    def rows(self, found: ReferenceItem, cell: Callable[[Template, int], str]) -> tuple[TemplateTrace, ...]:
        """Return what each template expects, up to the part that rules it out; `cell` gives one entry."""
        lead, rows = self.lead(found), []
        for template in self.templates:
            dies_at, why = self.dead.get(template.name, (None, ""))
            cells = tuple(
                cell(template, index) for index in range(len(self.parts) if dies_at is None else dies_at + 1)
            )
            is_chosen = template is lead and found.message is not None
            rows.append(TemplateTrace(template.name, cells, dies_at, is_chosen, why))
        return tuple(rows)


def _death(
    template: Template,
    prefix: bytes,
    judged: Judgement,
    size: int | None,
    found: ReferenceItem,
    silent: bool,
    is_last: bool,
) -> tuple[str, str] | None:
    """Say why a packet that begins with `prefix` is not the template's; None while it may be."""
    why = template.death(prefix, judged, size)
    if why is not None or template.message.name == found.message:
        return why
    if judged.verdict is Verdict.WHOLE:
        return _whole_death(template, prefix, found)
    if silent and found.reason != "pending":
        return "incomplete", "the line falls silent before it is whole"
    if is_last and found.message is not None:
        return "order", f"{found.message} is complete"
    return None


def _whole_death(template: Template, image: bytes, found: ReferenceItem) -> tuple[str, str] | None:
    """Say why a whole packet or frame is not the template's; None if it is."""
    if template.message.name == found.message:
        return None
    past = found.request
    why = template.last_part(image, past.values if past is not None else None)
    return why or unchosen(template, found, past)


def _asked(past: PastRequest | None) -> tuple[str, Mapping[str, Any]] | None:
    return (past.name, past.values) if past is not None else None


def _size_of(framing: Framing, prefix: bytes) -> int | None:
    """Return the packet's size on the wire, as soon as its head says it."""
    if framing.fixed_size is not None:
        return framing.fixed_size
    if framing.affine is not None:
        return framing.affine.size_of(prefix)
    if framing.measure is not None:
        return framing.measure.size_of(prefix)
    return None


def _readings(lead: Template, living: Sequence[Template], prefix: bytes) -> tuple[FieldRead, ...]:
    found = lead.readings(prefix)
    name = "" if len(living) <= 1 else lead.name
    return tuple(FieldRead(name, field, value, unit) for field, value, unit in found)


def _completed(steps: list[Step], found: ReferenceItem) -> list[Step]:
    """Read fields that have no place of their own (texts, lists, stuffed bytes), when the packet is whole."""
    if found.fields is None or not steps:
        return steps
    shown = {reading.name.partition(".")[0] for step in steps for reading in step.read}
    rest = [
        FieldRead("", name, value)
        for name, value in found.fields.items()
        if name.partition(".")[0] not in shown and not name.startswith("_")
    ]
    return [*steps[:-1], replace(steps[-1], read=(*steps[-1].read, *rest))]


#: Place, text, and of a byte its offset.
Part = tuple[str, str, int | None]


def frame_parts(frame: AnyFrame, data: bytes) -> list[Part]:
    digits = 8 if frame.is_extended_id else 3
    kinds = [
        k for k, given in (("29 bits", frame.is_extended_id), ("remote", frame.is_remote_frame)) if given
    ]
    kinds += ["CAN FD"] if frame.is_fd else []
    parts: list[Part] = [("id", f"{frame.arbitration_id:0{digits}X}", None)]
    parts += [("kind", ", ".join(kinds), None)] if kinds else []
    parts.append(("length", str(len(data)), None))
    return parts + [(f"d{at}", f"{byte:02X}", at) for at, byte in enumerate(data)]


def frame_death(
    template: Template, frame: AnyFrame, data: bytes, part: Part, transport: Transport | None = None
) -> tuple[str, str] | None:
    message = template.message
    place, _, offset = part
    match place:
        case "id":
            if transport not in message.ways:
                return "transport", message.transport.title if message.transport is not None else "a frame"
            if message.identifier.match(frame.arbitration_id) is None:
                return "identifier", message.identifier.describe(8 if message.extended else 3)
            is_plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_fd)
            return ("kind of frame", _kind(message)) if is_plain and not _is_kind(message, frame) else None
        case "kind":
            return None if _is_kind(message, frame) else ("kind of frame", _kind(message))
        case "length":
            if message.lengths is not None and len(data) not in message.lengths:
                return "length", message.describe_lengths
            return None
        case _:
            assert offset is not None
            return template.death(data[: offset + 1], None, None)


def _is_kind(message: Message, frame: AnyFrame) -> bool:
    kind = (bool(frame.is_extended_id), bool(frame.is_remote_frame))
    return kind == (message.extended, message.remote) and bool(frame.is_fd) in message.formats


def _kind(message: Message) -> str:
    kinds = (("29 bits", message.extended), ("remote", message.remote), ("CAN FD", message.fd))
    return ", ".join(kind for kind, given in kinds if given) or "a plain data frame"


def unchosen(template: Template, found: ReferenceItem, request: PastRequest | None) -> tuple[str, str] | None:
    """Say why a template whose bytes fit is not what the frame is."""
    asks = [*template.message.reply_to, *template.message.after]
    if found.message is not None:
        if request is not None and asks:
            return "request", f"what was asked last, {request.name}, gives {found.message}"
        return "order", f"{found.message} is tried first"
    if asks and found.reason.startswith("unknown: needs"):
        names = "|".join(dict.fromkeys(request.message.name for request in asks))
        return "request", f"no {names} was seen that it answers"
    return None


def captures(lead: Template, living: Sequence[Template], frame: AnyFrame) -> tuple[FieldRead, ...]:
    raws = lead.message.identifier.match(frame.arbitration_id) or {}
    name = "" if len(living) <= 1 else lead.name
    return tuple(
        FieldRead(name, capture.name, capture.to_physical(raws[capture.name]), capture.unit)
        for capture in lead.message.identifier.captures
        if capture.name in raws
    )


def frame_cell(template: Template, part: Part) -> str:
    place, _, offset = part
    message = template.message
    match place:
        case "id":
            return message.identifier.describe(8 if message.extended else 3)
        case "kind":
            return _kind(message)
        case "length":
            return message.describe_lengths.removesuffix(" bytes")
        case _:
            assert offset is not None
            return template.cell(offset, None)
