"""Prints the scanners: which message a frame is, and where packets stand in a stream.

1. The text is the reference rule written out: at the lowest undecided offset the framings are tried in order; whole and
   checked: accept; all dead: skip one byte; still incomplete: wait.
2. Losses are appended to `lost` as (offset, size, reason); nothing else is a bin.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..columns.segments import in_segments
from ..declare.checks import Check, Extra
from ..declare.framing import Framing
from ..plan.choose import Choice
from .check import computed, print_check
from .names import literal
from .source import SourceText, comment_line

ARGUMENTS = "data, key, time, channel, raw, rx"


def print_choice(out: SourceText, name: str, choice: Choice) -> None:
    """A function `name(data, key, time, channel, raw, rx)` that tries the messages of `choice`."""
    if choice.offset is None:
        out.line(f"def {name}({ARGUMENTS}):")
        out.line("    return (")
        for index, message in enumerate(choice.names):
            out.line(f"        {'or ' if index else ''}decode_{message}({ARGUMENTS})")
        out.line("    )")
        out.line()
        return
    table = []
    for value, case in choice.cases:
        if case.offset is None and len(case.names) == 1:
            table.append(f"{value:#04x}: decode_{case.names[0]},")
        else:
            inner = f"{name}_{value:02x}"
            print_choice(out, inner, case)
            table.append(f"{value:#04x}: {inner},")
    out.line(f"_{name} = {{")
    for entry in table:
        out.line(f"    {entry}")
    out.line("}.get")
    out.line()
    out.line(f"def {name}({ARGUMENTS}):")
    out.line(f"    decode = _{name}(data[{choice.offset}]) if len(data) > {choice.offset} else None")
    out.line(f"    return decode({ARGUMENTS}) if decode is not None else None")
    out.line()


def print_stream(label: str, framings: Sequence[tuple[Framing, str]]) -> str:
    """The scan function of a wire: `framings` with the name of the function that decodes their packets."""
    out = SourceText()
    out.line(f'"""Stream scanner of {comment_line(label)}: generated from its spec."""')
    out.line()
    for number, (framing, _) in enumerate(framings):
        if _asks(framing):
            print_check(out, number, framing)
    out.line("def scan(buffer, base, i, stop, silent, time, emit, lose, state):")
    out.depth = 1
    out.line(
        '"""Decide `buffer` from `i` to `stop`, or as far as can be; `base` is its offset in the stream."""'
    )
    out.line("end = len(buffer)")
    out.line("starts = buffer.startswith")
    for number, (framing, _) in enumerate(framings):
        if _asks_sums(framing):
            out.line(f"summed_{number} = sums_{number}.end - base")
    out.line("while i < stop:")
    out.depth = 2
    out.line("bad = None")
    if len(framings) > 1:
        out.line("unclaimed = 0")
    for number, (framing, decode) in enumerate(framings):
        _framing(out, number, framing, decode, alone=len(framings) == 1)
    if len(framings) > 1:
        out.line("if unclaimed:")
        out.line("    lose(base + i, unclaimed, 'unknown')")
        out.line("    i += unclaimed")
        out.line("    continue")
    out.line("if bad is not None:")
    out.line("    lose(base + i, 1, bad)")
    out.line("    i += 1")
    out.line("    continue")
    if all(framing.sync for framing, _ in framings):
        out.line("# nothing here: on to the next byte that may open a packet")
        out.line("found = seek(buffer, i + 1)")
        out.line("j = found.start() if found is not None else end")
        out.line("if j > stop:")
        out.line("    j = stop")
    else:
        out.line("j = i + 1")
    out.line("lose(base + i, j - i, 'skipped')")
    out.line("i = j")
    out.depth = 1
    out.line("return i")
    return out.text()


def seek_pattern(framings: Sequence[Framing]) -> bytes:
    """A regular expression that finds where some framing may begin, whole sync or cut off by the buffer's end."""
    import re

    parts = []
    for framing in framings:
        text = b""
        for byte in reversed(framing.sync):
            mine = re.escape(bytes([byte]))
            text = mine + (b"(?:" + text + b"|\\Z)" if text else b"")
        parts.append(text)
    return b"|".join(dict.fromkeys(parts))


def _framing(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    """One framing's block: falls out of its bottom when the candidate is dead or bad."""
    if framing.end and framing.stuffing is None:
        _ended(out, number, framing, decode, alone=alone)
        return
    if not _has_sized_sync(framing):
        _judged(out, number, framing, decode, alone=alone)
        return
    sync = framing.sync
    at = len(sync)
    out.line(f"# {comment_line(f'{framing.name}: {describe(framing)}')}")
    out.line(f"if starts({literal(sync)}, i):")
    out.depth += 1
    depth = out.depth
    if framing.not_next:
        _more(out, f"end - i == {at}")
        values = sorted(framing.not_next)
        test = f"!= {values[0]:#04x}" if len(values) == 1 else f"not in {tuple(values)}"
        out.line(f"elif buffer[i + {at}] {test}:")
        out.depth += 1
    if framing.affine is not None:
        head = framing.affine.length
        _more(out, f"end - i < {head.offset + head.size}")
        out.line("else:")
        out.depth += 1
        length = f"buffer[i + {head.offset}]"
        if head.size > 1:
            length = f'from_bytes(buffer[i + {head.offset} : i + {head.offset + head.size}], "{head.order}")'
        factor = f"{framing.affine.factor} * " if framing.affine.factor != 1 else ""
        out.line(f"size = {factor}{length} + {framing.affine.constant}")
        out.line(f"if not {framing.min_size} <= size <= {framing.max_size}:")
        out.line("    bad = bad or 'malformed: length'" if not alone else "    bad = 'malformed: length'")
        _more(out, "end - i < size", word="elif")
        out.line("else:")
        out.depth += 1
        size = "size"
    else:
        size = str(framing.fixed_size)
        _more(out, f"end - i < {size}")
        out.line("else:")
        out.depth += 1
    out.line(f"j = i + {size}")
    _checked(out, number, framing, decode, alone=alone)
    out.depth = depth - 1
    if len(sync) > 1:
        out.line(f"elif end - i < {at} and {literal(sync)}.startswith(buffer[i:]):")
        _wait(out)


def _has_sized_sync(framing: Framing) -> bool:
    return bool(framing.sync) and (framing.affine is not None or framing.fixed_size is not None)


def _asks(framing: Framing) -> bool:
    """Whether the check is asked of whole packets, by a function of its own."""
    check = framing.check
    if check is None or framing.is_silent:
        return False
    if framing.end:
        return framing.stuffing is None
    plain = plain_cover(check, len(framing.sync), framing.check_size)
    return _has_sized_sync(framing) and (check.kind == "crc" or plain is None)


def _asks_sums(framing: Framing) -> bool:
    """Whether what the check of a failed candidate has summed is kept for the candidates in it."""
    return _asks(framing) and framing.check is not None and framing.check.kind != "crc"


def _ended(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    """Framings whose packets are closed by a mark."""
    sync, at, back = framing.sync, len(framing.sync), len(framing.end)
    out.line(f"# {comment_line(f'{framing.name}: {describe(framing)}')}")
    depth = out.depth
    if sync:
        out.line(f"if starts({literal(sync)}, i):")
        out.depth += 1
    if framing.not_next:
        _more(out, f"end - i == {at}")
        values = sorted(framing.not_next)
        out.line(f"elif buffer[i + {at}] not in {tuple(values)}:")
        out.depth += 1
    first = f"i + {at}" if at else "i"
    out.line(f"j = buffer.find({literal(framing.end)}, {first}, i + {framing.max_size})")
    word = "if"
    if framing.not_inside:
        out.line(f"k = j if j >= 0 else i + {framing.max_size}")
        tests = [f"buffer.find({literal(bytes([byte]))}, {first}, k) >= 0" for byte in framing.not_inside]
        out.line(f"if {' or '.join(tests)}:")
        out.line("    bad = bad or 'malformed: a byte that no packet has'")
        word = "elif"
    out.line(f"{word} j < 0:")
    out.line(f"    if end - i >= {framing.max_size}:")
    out.line("        bad = bad or 'malformed: no end'")
    out.line("    elif not silent:")
    out.line("        break")
    out.line("    else:")
    out.line("        bad = bad or 'malformed: incomplete'")
    least = framing.min_size - back
    if least > at:
        out.line(f"elif j - i < {least}:")
        out.line(f"    if j - i > {at}:")
        out.line("        bad = bad or 'malformed: length'")
        out.line("else:")
    else:
        out.line(f"elif j - i > {at}:")
    out.depth += 1
    out.line(f"j += {back}")
    if framing.check is not None:
        _asked(out, number, framing.check)
        out.line("    bad = bad or reason")
        out.line("else:")
        out.depth += 1
    _accept(out, framing, decode, alone=alone, cut=framing.check is not None)
    out.depth = depth
    if at > 1:
        out.line(f"elif end - i < {at} and {literal(sync)}.startswith(buffer[i:]):")
        _wait(out)


def _more(out: SourceText, test: str, *, word: str = "if") -> None:
    out.line(f"{word} {test}:")
    _wait(out)


def _wait(out: SourceText) -> None:
    out.line("    if not silent:")
    out.line("        break")
    out.line("    bad = bad or 'malformed: incomplete'")


def _checked(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    check, cut = framing.check, False
    end = f"j - {framing.check_size}" if framing.check_size else "j"
    failed = "bad = bad or 'malformed: checksum'"
    if check is not None:
        start = f"i + {len(framing.sync)}"
        plain = plain_cover(check, len(framing.sync), framing.check_size)
        if plain is not None and check.kind != "crc":
            start = f"i + {plain}" if plain else "i"
            stored = _stored(check, "j")
            out.line(f"if base + {start} <= sums_{number}.end:")
            out.line(
                f"    good = sums_{number}.compute(buffer, base, base + {start}, base + {end}) == {stored}"
            )
            out.line("    if good:")
            out.line("        state.work -= j - i  # counted with the records, not read again")
            out.line("else:")
            out.line(f"    good = {computed(check, number, f'buffer[{start}:{end}]')} == {stored}")
            out.line("    if not good:")
            out.line(f"        sums_{number}.fail(buffer[{start}:{end}], base + {start})")
            out.line("if not good:")
        elif plain is not None and not _has_extra(check):
            start = f"i + {plain}" if plain else "i"
            out.line(f"if crc_{number}(buffer[{start}:{end}]) != {_stored(check, 'j')}:")
            out.line(f"    state.work += {size_expr(framing, plain)}")
        else:
            _asked(out, number, check)
            failed, cut = "bad = bad or reason", True
        out.line(f"    {failed}")
        out.line("else:")
        out.depth += 1
    _accept(out, framing, decode, alone=alone, cut=cut)


def _asked(out: SourceText, number: int, check: Check) -> None:
    """Cuts the packet out, asks `check_N` of it, and begins the branch of a failure."""
    out.line("packet = buffer[i:j]")
    if check.kind == "crc":
        out.line(f"reason = check_{number}(packet)")
        out.line("if reason is not None:")
        out.line("    state.work += j - i")
        return
    out.line(f"if i > summed_{number}:")
    out.line(f"    reason = check_{number}(packet)")
    out.line("    if reason is not None:")
    out.line(f"        sums_{number}.fail(packet, base + i)")
    out.line(f"        summed_{number} = j")
    out.line("else:")
    out.line(f"    reason = failure_{number}(buffer, base, i, j)")
    out.line(f"    summed_{number} = sums_{number}.end - base")
    out.line("if reason is not None:")


def size_expr(framing: Framing, start: int) -> str:
    """How many bytes the check of a candidate reads."""
    return f"j - i - {start + framing.check_size}"


def _accept(out: SourceText, framing: Framing, decode: str, *, alone: bool, cut: bool = False) -> None:
    """Decodes the packet, which is `cut` out already or not."""
    if not cut:
        out.line("packet = buffer[i:j]")
    data = "packet"
    if framing.stuffing is not None:
        out.line(f"data = unstuff_{decode}(packet)")
        out.line("if data is None:")
        out.line("    bad = bad or 'malformed: stuffing'")
        out.line("else:")
        out.depth += 1
        data = "data"
    out.line(f"record = {decode}({data}, base + i, time, None, packet, None)")
    out.line("if record is not None:")
    out.line("    emit(record)")
    if alone:
        out.line("else:")
        out.line("    lose(base + i, j - i, 'unknown')")
        out.line("i = j")
        out.line("continue")
    else:
        out.line("    i = j")
        out.line("    continue")
        out.line("unclaimed = unclaimed or j - i")


def _judged(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    """Framings that end by silence, are stuffed as a whole or have no sync: judged by the framing itself."""
    out.line(f"# {comment_line(f'{framing.name}: {describe(framing)}')}")
    out.line(f"verdict, j, reason = judge_{number}(buffer, i, silent)")
    out.line("if verdict == 'more':")
    _wait(out)
    out.line("elif verdict == 'bad':")
    if framing.check is not None and not in_segments(framing):
        out.line("    if reason == 'malformed: checksum':")
        out.line(f"        state.work += min(end - i, {framing.max_size})")
    out.line("    bad = bad or reason")
    out.line("elif verdict == 'whole':")
    depth = out.depth
    out.depth += 1
    _accept(out, framing, decode, alone=alone)
    out.depth = depth


def _has_extra(check: Check) -> bool:
    return any(isinstance(part, Extra) for part in check.over or ())


def plain_cover(check: Check, sync: int, size: int) -> int | None:
    """Where the covered bytes start, when they are one run up to the check."""
    if check.over is None:
        return sync if check.text is None else None
    if len(check.over) != 1 or check.text is not None or not isinstance(check.over[0], slice):
        return None
    part = check.over[0]
    if part.stop not in (-size,) or (part.start or 0) < 0:
        return None
    return part.start or 0


def _stored(check: Check, end: str) -> str:
    if check.bytes == 1:
        return f"buffer[{end} - 1]"
    if check.bytes == 2:
        low, high = (2, 1) if check.order == "little" else (1, 2)
        return f"(buffer[{end} - {low}] | buffer[{end} - {high}] << 8)"
    return f'from_bytes(buffer[{end} - {check.bytes}:{end}], "{check.order}")'


def describe(framing: Framing) -> str:
    """One line: `FF FF | id length | … | inverted sum, 8 bits`."""
    parts = [framing.sync.hex(" ").upper()] if framing.sync else []
    names = [head.name or "const" for head in framing.heads]
    if names:
        parts.append(" ".join(names))
    parts.append("…")
    if framing.check is not None:
        parts.append(framing.check.describe)
    if framing.end:
        parts.append(framing.end.hex(" ").upper())
    if framing.is_silent:
        parts.append("silence")
    if framing.stuffing is not None:
        parts.append(f"stuffed ({type(framing.stuffing).__name__})")
    return " | ".join(parts)


__all__ = ["describe", "print_choice", "print_stream", "seek_pattern"]
