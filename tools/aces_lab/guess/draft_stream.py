"""What was guessed of a stream as the source of a spec, with its evidence in comments.

1. The framings are those whose packets were found: what the draft decodes is what the guess says.
2. What never changed belongs to no field; what the language cannot say is a comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from .checks import check_source
from .draft import (
    NOTHING,
    TITLE,
    data_lines,
    imports_of,
    own_name,
    payload_lines,
    plain,
    reference_said,
    wrapped,
)
from .fields import FieldGuess
from .framings import FramingGuess, framing_check
from .streams import PacketGuess, StreamGuess, body_end


def stream_source(
    guess: StreamGuess, name: str = "draft", files: Iterable[str] = (), as_bytes: Mapping[str, str] = NOTHING
) -> str:
    """Return the module that declares what was guessed of a stream as the protocol `name`; messages of `as_bytes` without
    their fields, for the reason that is given.
    """
    said = [f"Guessed from {guess.kept:,} bytes" + "".join(f", {file}" for file in files) + "."]
    said.append(f"{guess.decoded:,} of them are in packets; the rest is unknown.")

    if guess.reference is not None:
        said += reference_said(guess.reference)
    own = own_name(name)
    body: list[str] = []
    for number, framing in enumerate(guess.framings):
        variable = "packet" if len(guess.framings) == 1 else f"packet_{number}"
        body += ["", *_framing(framing, own, variable)]
        if framing.kind == "lines" and framing.opcode is not None:
            body.append(
                f'{variable}_of = {variable}.family(prefix=Struct("word" / Bytes({framing.opcode[1]})))'
            )
        for packet in guess.packets:
            if packet.framing == number:
                body += ["", *_message(packet, framing, variable, as_bytes)]
    comments = [line for text in said for line in _comment(text)]
    return "\n".join(
        [TITLE, "", *comments, "", *imports_of(body), f'{own} = Protocol("{own}", link="serial")', *body, ""]
    )


def _comment(text: str) -> list[str]:
    return wrapped(plain(text), "# ", "#   ")


def _framing(framing: FramingGuess, own: str, variable: str) -> Iterator[str]:
    yield from _comment(
        f"{framing.packets:,} packets, {framing.share:.1%} of the bytes ({framing.confidence:.2f})"
    )
    for line in framing.evidence:
        yield from _comment(line)
    check = framing_check(framing)
    if framing.check is not None and check is None:
        yield from _comment(f"not declared, as no framing can say it: {framing.check.declared}")
    yield f"{variable} = {own}.framing("
    yield f'    name="{variable}",'
    if framing.sync:
        yield f"    sync={framing.sync!r},"
    if framing.not_next:
        yield f"    not_next={framing.not_next!r},"
    head = ", ".join(f'"{field}" / {construct}' for field, construct in framing.head_fields())
    if head:
        yield f"    header=Struct({head}),"
    if framing.length is not None:
        constant = framing.length.constant
        sign = f" {'+' if constant > 0 else '-'} {abs(constant)}" if constant else ""
        yield f"    size=this.length{sign},"
    elif framing.size is not None:
        yield f"    size={framing.size},"
    elif framing.kind == "silence":
        yield '    end="silence",'
    else:
        yield f"    end={framing.end!r},"
    if framing.stuffing is not None:
        yield f"    stuffing={framing.stuffing_source},"
    if framing.gap_s is not None:
        yield f"    gap={framing.gap_s!r},  # s"
    if framing.max_size:
        yield f"    max_size={framing.max_size},"
    if check is not None:
        yield f"    check={check_source(check)},"
    yield ")"


def _message(
    packet: PacketGuess, framing: FramingGuess, variable: str, as_bytes: Mapping[str, str]
) -> Iterator[str]:
    sizes = (
        f"{packet.sizes[0]} bytes"
        if len(packet.sizes) == 1
        else f"{packet.sizes[0]} to {packet.sizes[-1]} bytes"
    )
    yield from _comment(f"{packet.count:,} packets of {sizes}, as {packet.example[:24].hex(' ').upper()}")
    if framing.kind == "lines":
        yield from _line(packet, framing, variable)
        return
    code = "" if packet.opcode is None else f"_{packet.opcode.hex().upper()}"
    name = f"{variable.title()}{code}"
    yield f"{variable}("
    yield f'    "{name}",'
    if packet.opcode is not None:
        yield f'    match={{"opcode": 0x{packet.opcode.hex().upper()}}},'
    size = max(0, packet.size - framing.head_end - body_end(framing))
    lines = payload_lines(_without_checks(packet.fields), size, len(packet.sizes) > 1)
    if name in as_bytes:
        lines = data_lines(as_bytes[name])
    if lines:
        yield f"    payload={lines[0]}"
        yield from (f"    {line}" for line in lines[1:-1])
        if len(lines) > 1:
            yield f"    {lines[-1]},"
    yield ")"


def _without_checks(fields: Iterable[FieldGuess]) -> list[FieldGuess]:
    """Turn checks among the fields into numbers: the framing itself has the packet's check."""
    return [replace(field, kind="number", check=None) if field.kind == "check" else field for field in fields]


def _line(packet: PacketGuess, framing: FramingGuess, variable: str) -> Iterator[str]:
    if packet.opcode is None:
        yield f'{variable}("{variable.title()}", payload=Struct("text" / GreedyBytes))'
        return
    end = len(packet.example) - body_end(framing)
    rest = packet.example[len(framing.sync) + len(packet.opcode) : end].decode("latin-1")
    name = re.sub(r"\W", "_", packet.opcode.decode("latin-1"))
    name = name if name.isidentifier() else f"Line_{name}"
    separator = rest[:1] if rest[:1] and not rest[:1].isalnum() else ""
    if not separator:
        payload = 'Struct("text" / GreedyBytes)'
    else:
        payload = f'Delimited({separator!r}, "field_1" / AsciiText(), lead=True, more=True)'
    yield f'{variable}_of("{name}", word={packet.opcode!r}, payload={payload})'
