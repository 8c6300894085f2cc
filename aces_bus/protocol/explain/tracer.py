"""The reference's decisions, each as an `Attempt`.

1. What is decided, and by what, is in the reference's items: this class asks each template afterwards, byte by byte. So
   the records explained are those of every scanner (law 2).
2. Attempts are explained when they are looked at; deciding costs what the reference costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from ..declare.framing import Framing, Judgement, Verdict
from ..declare.message import Direction
from ..declare.packet import can_image
from ..declare.protocol import Variant
from ..reference import PastRequest, Reference, ReferenceItem
from .attempt import Attempt, Death, FieldRead, Step, TemplateTrace
from .template import Template
from .words import captures, frame_cell, frame_death, unchosen, words_of

#: Words of one attempt that are explained; of longer packets the first ones and the last.
WORDS = 160


class Tracer(Reference):
    """A `Reference` that can explain itself; its records are in physical units."""

    def __init__(
        self, variants: Sequence[Variant], *, direction: Direction | Literal["both"] | None = None
    ) -> None:
        super().__init__(variants, direction=direction)
        is_alone = len({variant.name for variant in variants}) == 1
        self.templates: list[Template] = []
        self._extras: dict[Framing, dict[int, bytes]] = {}
        for variant, messages, _, _ in self.sides:
            for message in messages:
                name = message.name if is_alone else f"{variant.name}.{message.name}"
                self.templates.append(Template(message, name))
                if message.framing is not None and message.extras is not None:
                    self._extras.setdefault(message.framing, {}).update(message.extras)

    @property
    def interesting(self) -> frozenset[str]:
        """Messages that later ones may hang on, or that hang on earlier ones."""
        found: set[str] = set()
        for _, _, contextual, context in self.sides:
            found |= set(contextual) | set(context.requests) | set(context.answers)
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
        """The attempts at a stream, `stream`'s decisions; `base` is the offset of its first byte.

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
        start, end, past = found.offset, found.known, found.request
        steps: list[Step] = []
        alive = list(self.templates)
        dead: dict[str, tuple[int, str]] = {}
        sizes: dict[Framing, int] = {}
        size: int | None = found.size if found.message is not None else None
        traces: list[tuple[int, bytes, list[Death], list[Template]]] = []
        at = start
        left_out = 0
        while alive and at < end:
            at += 1
            prefix = data[start:at]
            is_last = at == end or (size is not None and len(prefix) == size)
            died: list[Death] = []
            verdicts: dict[Framing, Judgement] = {}
            for template in list(alive):
                framing = template.framing
                assert framing is not None
                if framing not in verdicts:
                    verdicts[framing] = framing.judge(
                        prefix, 0, silent=at == end and found.is_silent, extras=self._extras.get(framing)
                    )
                    known = _size_of(framing, prefix)
                    if known is not None:
                        sizes[framing] = known
                judged = verdicts[framing]
                why = template.death(prefix, judged, sizes.get(framing))
                if why is None and template.message.name != found.message:
                    is_whole = judged.verdict is Verdict.WHOLE
                    if is_whole:
                        why = template.last_word(prefix, past.values if past is not None else None)
                        why = why or unchosen(template, found, past)
                    elif at == end and found.is_silent and found.reason != "pending":
                        why = "incomplete", "the line falls silent before it is whole"
                    elif is_last and found.message is not None:
                        why = "order", f"{found.message} is complete"
                if why is not None:
                    died.append(Death(template.name, *why))
                    dead[template.name] = len(traces), why[0]
                    alive.remove(template)
            traces.append((at - start - 1, prefix, died, list(alive)))
            if is_last:
                break
            if len(traces) == WORDS and alive:
                # Of what is longer only the end is of interest: there length, end and check decide.
                reach = size or max(
                    sizes.get(t.framing) or t.framing.max_size for t in alive if t.framing is not None
                )
                last = min(end, start + reach)
                left_out = max(0, last - at - 1)
                at += left_out
        lead = self._lead(found, traces)
        for offset, prefix, died, living in traces:
            known = sizes.get(lead.framing) if lead.framing is not None else None
            read = _readings(lead, living, prefix)
            what = lead.label(offset, size if size is not None else known, prefix)
            steps.append(
                Step(
                    str(base + start + offset),
                    f"{prefix[-1]:02X}",
                    what,
                    tuple(died),
                    read,
                    tuple(t.name for t in living),
                )
            )
        steps = _completed(steps, found, lead)
        rows = self._rows([t[0] for t in traces], dead, sizes, size, found, lead)
        return Attempt(
            base + start,
            tuple(t.name for t in self.templates),
            tuple(steps),
            rows,
            replace(found, offset=base + found.offset),
            base + start + found.size,
            _asked(past),
            left_out=left_out,
            raw=data[start : start + found.size],
        )

    def _lead(
        self, found: ReferenceItem, traces: Sequence[tuple[int, bytes, list[Death], list[Template]]]
    ) -> Template:
        """The template whose words are named: the one that was accepted, else one that lived longest."""
        for template in self.templates:
            if found.message is not None and template.message.name == found.message:
                if found.protocol in (None, template.message.protocol.name):
                    return template
        by_name = {template.name: template for template in self.templates}
        for _, _, died, living in reversed(traces):
            if living:
                return living[0]
            if died:
                return by_name[died[0].template]
        return self.templates[0]

    def _rows(
        self,
        offsets: Sequence[int],
        dead: Mapping[str, tuple[int, str]],
        sizes: Mapping[Framing, int],
        size: int | None,
        found: ReferenceItem,
        lead: Template,
    ) -> tuple[TemplateTrace, ...]:
        rows: list[TemplateTrace] = []
        for template in self.templates:
            dies_at, why = dead.get(template.name, (None, ""))
            upto = len(offsets) if dies_at is None else dies_at + 1
            known = sizes.get(template.framing) if template.framing is not None else None
            cells = tuple(
                template.cell(at, size if template is lead and size else known) for at in offsets[:upto]
            )
            rows.append(
                TemplateTrace(
                    template.name, cells, dies_at, template is lead and found.message is not None, why
                )
            )
        return tuple(rows)

    # ------------------------------------------------------------------ frames

    def explain_frame(self, frame: Any, number: int = 0) -> Attempt:
        """What a frame is, and why; frames must come in their order, since replies hang on requests."""
        (found,) = self.frames([frame])
        found, past = replace(found, offset=number), found.request
        data = bytes(frame.data)
        image = can_image(
            frame.arbitration_id,
            data,
            extended=frame.is_extended_id,
            remote=frame.is_remote_frame,
            fd=frame.is_fd,
        )
        if frame.is_error_frame:
            return Attempt(number, (), (), (), found, number + 1, is_can=True, frame=frame, raw=data)
        alive = list(self.templates)
        dead: dict[str, tuple[int, str]] = {}
        deaths: list[list[Death]] = []
        living: list[list[Template]] = []
        words = words_of(frame, data)
        for index in range(len(words)):
            died: list[Death] = []
            for template in list(alive):
                why = frame_death(template, frame, data, words[index])
                is_over = index == len(words) - 1 and why is None
                if is_over and template.message.name != found.message:
                    why = template.last_word(image, past.values if past is not None else None)
                    why = why or unchosen(template, found, past)
                if why is not None:
                    died.append(Death(template.name, *why))
                    dead[template.name] = index, why[0]
                    alive.remove(template)
            deaths.append(died)
            living.append(list(alive))
        lead = self._lead(found, [(0, b"", d, a) for d, a in zip(deaths, living, strict=True)])
        steps: list[Step] = []
        for index, (place, word, offset) in enumerate(words):
            read: tuple[FieldRead, ...] = ()
            what = {"id": "identifier", "kind": "kind of frame", "length": "length"}.get(place, "")
            if place == "id" and lead.message.identifier.match(frame.arbitration_id) is not None:
                read = captures(lead, living[index], frame)
            elif offset is not None:
                what = lead.label(offset, len(data), data[: offset + 1])
                if lead in living[index] or lead.name in {d.template for d in deaths[index]}:
                    read = _readings(lead, living[index], data[: offset + 1])
            steps.append(
                Step(place, word, what, tuple(deaths[index]), read, tuple(t.name for t in living[index]))
            )
        steps = _completed(steps, found, lead)
        rows: list[TemplateTrace] = []
        for template in self.templates:
            dies_at, cause = dead.get(template.name, (None, ""))
            cells = tuple(
                frame_cell(template, word) for word in words[: None if dies_at is None else dies_at + 1]
            )
            is_chosen = template is lead and found.message is not None
            rows.append(TemplateTrace(template.name, cells, dies_at, is_chosen, cause))
        return Attempt(
            number,
            tuple(t.name for t in self.templates),
            tuple(steps),
            tuple(rows),
            found,
            number + 1,
            _asked(past),
            is_can=True,
            frame=frame,
            raw=data,
        )

    def explain_frames(self, frames: Iterable[Any]) -> list[Attempt]:
        """The attempts at some frames."""
        return [self.explain_frame(frame, number) for number, frame in enumerate(frames)]


def _asked(past: PastRequest | None) -> tuple[str, Mapping[str, Any]] | None:
    return (past.name, past.values) if past is not None else None


def _size_of(framing: Framing, prefix: bytes) -> int | None:
    """The packet's size on the wire, as soon as its head says it."""
    if framing.fixed_size is not None:
        return framing.fixed_size
    if framing.affine is not None:
        head = framing.affine.length
        if len(prefix) >= head.offset + head.size:
            return framing.affine.factor * head.number(prefix) + framing.affine.constant
    return None


def _readings(lead: Template, living: Sequence[Template], prefix: bytes) -> tuple[FieldRead, ...]:
    found = lead.readings(prefix)
    name = "" if len(living) <= 1 else lead.name
    return tuple(FieldRead(name, field, value, unit) for field, value, unit in found)


def _completed(steps: list[Step], found: ReferenceItem, lead: Template) -> list[Step]:
    """Fields that have no place of their own (texts, lists, stuffed bytes) are read when the packet is whole."""
    if found.fields is None or not steps:
        return steps
    shown = {reading.name.partition(".")[0] for step in steps for reading in step.read}
    rest = [
        FieldRead("", name, value)
        for name, value in found.fields.items()
        if name.partition(".")[0] not in shown and not name.startswith("_")
    ]
    return [*steps[:-1], replace(steps[-1], read=(*steps[-1].read, *rest))]
