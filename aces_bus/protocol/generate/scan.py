"""Prints the scanners: which message a frame is, where packets are in a stream, and why a packet's check fails.

1. The text is the reference rule written out: at the lowest undecided offset the framings are tried in order; whole and
   checked: accept; all dead: skip one byte; still incomplete: wait.
2. Losses are appended to `lost` as (offset, size, reason); nothing else is a bin.
3. A check reads what is on the wire, and agrees with `Framing.judge`. The names it uses: `crc_N`, `xor`, `fletcher` (numbers
   of bytes), `extras_N` (a message's bytes by its number), `text_N` (how a number is written), `texts_N` (numbers as
   characters), `same_N` (whether characters are the same number).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import groupby

import msgspec

from ..declare.checks import Check, Covered, Extra, Fletcher, Sum, Xor
from ..declare.framing import Framing
from ..declare.head import Head
from ..plan.nodes import MessagePlan
from .source import SourceText, comment_line, literal

# ---------------------------------------------------------------------- which of several messages a packet is
#
# 1. Order is kept: what is tried first is what was declared (or ordered by `overrides`) first.
# 2. A choice is a byte to look at and, for each value, the messages left; or a list to try in turn.


class Choice(msgspec.Struct, frozen=True):
    """Look at byte `offset`: `cases` are the choices by its value, `names` what to try when there is no byte to look at."""

    names: tuple[str, ...]
    offset: int | None = None
    cases: tuple[tuple[int, Choice], ...] = ()


def choose(plans: Sequence[MessagePlan], tried: frozenset[int] = frozenset()) -> Choice:
    """Return the choice among messages that share identifier or framing."""
    names = tuple(plan.name for plan in plans)
    if len(plans) < 2:
        return Choice(names)
    best: tuple[int, int] | None = None
    known = [_fixed_bytes(plan) for plan in plans]
    for offset in sorted(set().union(*known) - tried):
        if not all(offset in fixed for fixed in known):
            continue
        distinct = len({value for fixed in known for value in fixed[offset]})
        if distinct > 1 and (best is None or distinct > best[0]):
            best = (distinct, offset)
    if best is None:
        return Choice(names)
    offset = best[1]
    values = sorted({value for fixed in known for value in fixed[offset]})
    cases = []
    for value in values:
        left = [plan for plan, fixed in zip(plans, known, strict=True) if value in fixed[offset]]
        cases.append((value, choose(left, tried | {offset})))
    return Choice(names, offset, tuple(cases))


def _fixed_bytes(plan: MessagePlan) -> dict[int, tuple[int, ...]]:
    """Return the bytes that a message allows only some values, by offset."""
    found: dict[int, tuple[int, ...]] = {c.offset: (c.value,) for c in plan.constants if c.mask == 0xFF}
    for choice in plan.one_of:
        if choice.number.size == 1:
            found[choice.number.offset] = tuple(choice.values)
    return found


# ---------------------------------------------------------------------- printing


ARGUMENTS = "data, key, time, channel, raw, rx"


def print_choice(out: SourceText, name: str, choice: Choice) -> None:
    """Print a function `name(data, key, time, channel, raw, rx)` that tries the messages of `choice`."""
    if choice.offset is None:
        out.lines(
            f"def {name}({ARGUMENTS}):",
            "    return (",
        )
        for index, message in enumerate(choice.names):
            out.line(f"        {'or ' if index else ''}decode_{message}({ARGUMENTS})")
        out.lines(
            "    )",
            "",
        )
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
    out.lines(
        "}.get",
        "",
        f"def {name}({ARGUMENTS}):",
        f"    decode = _{name}(data[{choice.offset}]) if len(data) > {choice.offset} else None",
        f"    return decode({ARGUMENTS}) if decode is not None else None",
        "",
    )


def print_stream(label: str, framings: Sequence[tuple[Framing, str]], answering: Collection[int] = ()) -> str:
    """Return the scan function of a wire: `framings` with the name of the function that decodes their packets. Those whose
    numbers are in `answering` are tried only where `asked()` names them.
    """
    out = SourceText()
    out.lines(
        f'"""Stream scanner of {comment_line(label)}: generated from its spec."""',
        "",
    )
    for number, (framing, _) in enumerate(framings):
        if _asks(framing):
            print_check(out, number, framing)
    out.line("def scan(buffer, base, i, stop, silent, time, emit, lose, state):")
    out.depth = 1
    out.lines(
        '"""Decide `buffer` from `i` to `stop`, or as far as can be; `base` is its offset in the stream."""',
        "end = len(buffer)",
        "starts = buffer.startswith",
    )
    for number, (framing, _) in enumerate(framings):
        if _asks_sums(framing):
            out.line(f"summed_{number} = sums_{number}.end - base")
    out.line("while i < stop:")
    out.depth = 2
    out.line("bad = None")
    if len(framings) > 1:
        out.line("unclaimed = 0")
    if answering:
        out.line("answers = asked()")
    for first, some in groupby(range(len(framings)), lambda number: _first_byte(framings[number][0])):
        run = list(some)
        known = first if len(run) > 1 else None
        if known is not None:
            out.line(f"if buffer[i] in {_set_of(known)}:")
        for number in run:
            out.depth = 2 + (known is not None)
            if number in answering:
                out.line(f"if {number} in answers:")
                out.depth += 1
            framing, decode = framings[number]
            _framing(out, number, framing, decode, alone=len(framings) == 1, known=known)
        out.depth = 2
    if len(framings) > 1:
        out.lines(
            "if unclaimed:",
            "    lose(base + i, unclaimed, 'unknown')",
            "    i += unclaimed",
            "    continue",
        )
    out.lines(
        "if bad is not None:",
        "    lose(base + i, 1, bad)",
        "    i += 1",
        "    continue",
    )
    if all(framing.sync for framing, _ in framings):
        out.lines(
            "# nothing here: on to the next byte that may open a packet",
            "found = seek(buffer, i + 1)",
            "j = found.start() if found is not None else end",
            "if j > stop:",
            "    j = stop",
        )
    else:
        out.line("j = i + 1")
    out.lines(
        "lose(base + i, j - i, 'skipped')",
        "i = j",
    )
    out.depth = 1
    out.line("return i")
    return out.text()


def seek_pattern(framings: Sequence[Framing]) -> bytes:
    """Return a regular expression that finds where some framing may begin, whole sync or cut off by the buffer's end."""
    import re

    parts = []
    for framing in framings:
        text = b""
        for byte in reversed(framing.sync):
            mine = re.escape(bytes([byte]))
            text = mine + (b"(?:" + text + b"|\\Z)" if text else b"")
        parts.append(text)
    return b"|".join(dict.fromkeys(parts))


def _first_byte(framing: Framing) -> Collection[int] | None:
    """Return what the first byte of a packet may be, where its framing has no sync and `_framing` asks for it."""
    if framing.sync or not framing.match or not _has_sized_start(framing):
        return None
    head, numbers = framing.match[0]
    return numbers if head.offset == 0 and head.size == 1 else None


def _framing(
    out: SourceText,
    number: int,
    framing: Framing,
    decode: str,
    *,
    alone: bool,
    known: Collection[int] | None = None,
) -> None:
    """Print one framing's block, which falls out of its bottom when the candidate is dead or bad. `known` says that its
    first byte has been asked for.
    """
    if framing.end and framing.stuffing is None and not _is_judged(framing):
        _ended(out, number, framing, decode, alone=alone)
        return
    if not _has_sized_start(framing):
        _judged(out, number, framing, decode, alone=alone)
        return
    sync = framing.sync
    at = len(sync)
    out.line(f"# {comment_line(f'{framing.name}: {describe(framing)}')}")
    if sync:
        out.line(f"if starts({literal(sync)}, i):")
        out.depth += 1
    depth = out.depth
    for head, numbers in framing.match[known is not None :]:
        _more(out, f"end - i <= {head.offset}")
        out.line(f"elif buffer[i + {head.offset}] in {_set_of(numbers)}:")
        out.depth += 1
    if framing.not_next:
        _more(out, f"end - i == {at}")
        values = sorted(framing.not_next)
        test = f"!= {values[0]:#04x}" if len(values) == 1 else f"not in {tuple(values)}"
        out.line(f"elif buffer[i + {at}] {test}:")
        out.depth += 1
    if framing.affine is not None:
        head = framing.affine.length
        flags = framing.affine.flags
        _more(out, f"end - i < {framing.affine.reach if flags is not None else head.offset + head.size}")
        length = candidate_number(head)
        factor = f"{framing.affine.factor} * " if framing.affine.factor != 1 else ""
        constant, wide, escape = framing.affine.constant, framing.affine.wide, framing.affine.escape
        if wide is not None:
            _more(out, f"{length} == {escape} and end - i < {framing.affine.reach}", word="elif")
        out.line("else:")
        out.depth += 1
        if wide is None:
            out.line(f"size = {factor}{length} + {constant}")
            if flags is not None:
                out.lines(
                    f"if {candidate_number(flags)} & {framing.affine.mask:#x}:",
                    f"    size += {framing.affine.more}",
                )
        else:
            out.lines(
                f"size = {length}",
                f"if size < {escape}:",
                f"    size = {factor}size + {constant}",
                "else:",
                f"    wide = {candidate_number(wide)}",
                f"    size = {factor}wide + {constant + wide.size} if size == {escape} <= wide else 0",
            )
        odd = f" or size & {framing.multiple - 1}" if framing.multiple > 1 else ""
        out.lines(
            f"if not {framing.min_size} <= size <= {framing.max_size}{odd}:",
            "    bad = bad or 'malformed: length'" if not alone else "    bad = 'malformed: length'",
        )
        _more(out, "end - i < size", word="elif")
        out.line("else:")
        out.depth += 1
        size = "size"
    elif framing.measure is not None:
        out.lines(
            f"size = measure_{number}(buffer, i, end)",
            f"if size is None and end - i < {framing.max_size}:",
        )
        _wait(out)
        out.lines(
            f"elif size is None or not {framing.min_size} <= size <= {framing.max_size}:",
            "    bad = bad or 'malformed: length'" if not alone else "    bad = 'malformed: length'",
        )
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
    out.depth = depth - bool(sync)
    if len(sync) > 1:
        out.line(f"elif end - i < {at} and {literal(sync)}.startswith(buffer[i:]):")
        _wait(out)


def candidate_number(head: Head) -> str:
    """Return the number in these bytes of the candidate at `i`, as an expression."""
    if head.size == 1:
        return f"buffer[i + {head.offset}]"
    return f'from_bytes(buffer[i + {head.offset} : i + {head.offset + head.size}], "{head.order}")'


def _number_in(head: Head) -> str:
    """Return the number in these bytes of a packet that was cut out, as an expression."""
    if head.size == 1:
        return f"packet[{head.offset}]"
    return f'from_bytes(packet[{head.offset}:{head.offset + head.size}], "{head.order}")'


def _set_of(numbers: Collection[int]) -> str:
    """Return numbers as a set that is written once."""
    return f"{{{', '.join(map(str, sorted(numbers)))}}}"


def _has_sized_start(framing: Framing) -> bool:
    """Return whether the first bytes say that a packet may begin, and how long it is."""
    return (
        bool(framing.sync or framing.match)
        and not _is_judged(framing)
        and (framing.affine is not None or framing.fixed_size is not None or framing.measure is not None)
    )


def _is_judged(framing: Framing) -> bool:
    """Return whether the framing itself judges packets, by a check that needs more than their bytes up to their end."""
    return framing.covers_request or bool(framing.check_behind)


def _asks(framing: Framing) -> bool:
    """Return whether the check is asked of whole packets, by a function of its own."""
    check = framing.check
    if check is None or framing.is_silent or _is_judged(framing):
        return False
    if framing.end:
        return framing.stuffing is None
    return _has_sized_start(framing) and (check.kind == "crc" or plain_cover(framing) is None)


def _asks_sums(framing: Framing) -> bool:
    """Return whether what the check of a failed candidate has summed is kept for the candidates in it."""
    return _asks(framing) and framing.check is not None and framing.check.kind != "crc"


def _ended(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    """Print framings whose packets are closed by a mark."""
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
    mark, stop = framing.short_end or framing.end, "j"
    out.line(f"j = buffer.find({literal(mark)}, {first}, i + {framing.max_size})")
    if framing.short_end:  # e: where the end begins, whole or not
        lead, stop = back - len(mark), "e"
        out.line(
            f"e = j - {lead} if j - i >= {at + lead} and starts({literal(framing.end)}, j - {lead}) else j"
        )
    word = "if"
    if framing.not_inside:
        out.line(f"k = {stop} if j >= 0 else i + {framing.max_size}")
        tests = [f"buffer.find({literal(bytes([byte]))}, {first}, k) >= 0" for byte in framing.not_inside]
        out.lines(
            f"if {' or '.join(tests)}:",
            "    bad = bad or 'malformed: a byte that no packet has'",
        )
        word = "elif"
    out.lines(
        f"{word} j < 0:",
        f"    if end - i >= {framing.max_size}:",
        "        bad = bad or 'malformed: no end'",
        "    elif not silent:",
        "        break",
        "    else:",
        "        bad = bad or 'malformed: incomplete'",
    )
    least = framing.min_size - back
    if least > at:
        out.lines(
            f"elif {stop} - i < {least}:",
            f"    if {stop} - i > {at}:",
            "        bad = bad or 'malformed: length'",
            "else:",
        )
    else:
        out.line(f"elif {stop} - i > {at}:")
    out.depth += 1
    out.line(f"j += {len(mark)}")
    if framing.short_end:
        out.lines(
            "packet = buffer[i:j]",
            f"data = packet if j - e == {back} else buffer[i:e] + {literal(framing.end)}",
        )
    if framing.check is not None:
        _asked(out, number, framing.check, short=framing.short_end, end=f"e + {back}")
        out.lines(
            "    bad = bad or reason",
            "else:",
        )
        out.depth += 1
    _accept(out, framing, decode, alone=alone, cut=framing.check is not None or bool(framing.short_end))
    out.depth = depth
    if at > 1:
        out.line(f"elif end - i < {at} and {literal(sync)}.startswith(buffer[i:]):")
        _wait(out)


def _more(out: SourceText, test: str, *, word: str = "if") -> None:
    out.line(f"{word} {test}:")
    _wait(out)


def _wait(out: SourceText) -> None:
    out.lines(
        "    if not silent:",
        "        break",
        "    bad = bad or 'malformed: incomplete'",
    )


def _checked(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    check, cut = framing.check, False
    end = f"j - {framing.check_size}" if framing.check_size else "j"
    failed = "bad = bad or 'malformed: checksum'"
    if check is not None:
        start = f"i + {len(framing.sync)}"
        plain = plain_cover(framing)
        if plain is not None and check.kind != "crc":
            start = f"i + {plain}" if plain else "i"
            stored = _stored(check, "j")
            out.lines(
                f"if base + {start} <= sums_{number}.end:",
                f"    good = sums_{number}.compute(buffer, base, base + {start}, base + {end}) == {stored}",
                "    if good:",
                "        state.work -= j - i  # counted with the records, not read again",
                "else:",
                f"    good = {computed(check, number, f'buffer[{start}:{end}]')} == {stored}",
                "    if not good:",
                f"        sums_{number}.fail(buffer[{start}:{end}], base + {start})",
                "if not good:",
            )
        elif plain is not None and not _has_extra(check) and framing.trailer is None:
            start = f"i + {plain}" if plain else "i"
            out.lines(
                f"if crc_{number}(buffer[{start}:{end}]) != {_stored(check, 'j')}:",
                f"    state.work += {size_expr(framing, plain)}",
            )
        else:
            _asked(out, number, check)
            failed, cut = "bad = bad or reason", True
        out.lines(
            f"    {failed}",
            "else:",
        )
        out.depth += 1
    _accept(out, framing, decode, alone=alone, cut=cut)


def _asked(out: SourceText, number: int, check: Check, *, short: bytes = b"", end: str = "j") -> None:
    """Print the cutting of the packet, the question to `check_N`, and the begin of the branch of a failure.

    Where packets may have a `short` end, they are cut already, `data` has the whole end, and `end` is where it would be.
    """
    data = "data" if short else "packet"
    if not short:
        out.line("packet = buffer[i:j]")
        end = "j"
    if check.kind == "crc":
        out.lines(
            f"reason = check_{number}({data})",
            "if reason is not None:",
            "    state.work += j - i",
        )
        return
    out.lines(
        f"if i > summed_{number}:",
        f"    reason = check_{number}({data})",
        "    if reason is not None:",
        f"        sums_{number}.fail(packet, base + i)",
        f"        summed_{number} = j",
        "else:",
        f"    reason = failure_{number}(buffer, base, i, {end})",
        f"    summed_{number} = sums_{number}.end - base",
        "if reason is not None:",
    )


def size_expr(framing: Framing, start: int) -> str:
    """Return how many bytes the check of a candidate reads."""
    return f"j - i - {start + framing.check_size}"


def _accept(out: SourceText, framing: Framing, decode: str, *, alone: bool, cut: bool = False) -> None:
    """Print the decoding of a packet, which is `cut` out already or not."""
    if not cut:
        out.line("packet = buffer[i:j]")
    data = "data" if framing.short_end else "packet"
    if framing.stuffing is not None:
        out.lines(
            f"data = unstuff_{decode}(packet)",
            "if data is None:",
            "    bad = bad or 'malformed: stuffing'",
            "else:",
        )
        out.depth += 1
        data = "data"
    out.lines(
        f"record = {decode}({data}, base + i, time, None, packet, None)",
        "if record is not None:",
        "    emit(record)",
    )
    if alone:
        out.lines(
            "else:",
            "    lose(base + i, j - i, 'unknown')",
            "i = j",
            "continue",
        )
    else:
        out.lines(
            "    i = j",
            "    continue",
            "unclaimed = unclaimed or j - i",
        )


def _judged(out: SourceText, number: int, framing: Framing, decode: str, *, alone: bool) -> None:
    """Print framings that end by silence, are stuffed as a whole, have no sync or a check over their request: judged by the
    framing itself.
    """
    out.lines(
        f"# {comment_line(f'{framing.name}: {describe(framing)}')}",
        f"verdict, j, reason = judge_{number}(buffer, i, silent)",
        "if verdict == 'more':",
    )
    _wait(out)
    out.line("elif verdict == 'bad':")
    if framing.check is not None and not framing.is_enclosed:
        out.lines(
            "    if reason == 'malformed: checksum':",
            f"        state.work += min(end - i, {framing.max_size})",
        )
    out.lines(
        "    bad = bad or reason",
        "elif verdict == 'whole':",
    )
    depth = out.depth
    out.depth += 1
    _accept(out, framing, decode, alone=alone)
    out.depth = depth


def _has_extra(check: Check) -> bool:
    return any(isinstance(part, Extra) for part in check.over or ())


def plain_cover(framing: Framing) -> int | None:
    """Return where the covered bytes start, when they are one run up to the check."""
    check, size = framing.check, framing.check_size
    if check is None or framing.check_head is not None:
        return None
    if check.over is None:
        return len(framing.sync) if check.text is None else None
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
    """Describe a framing in one line: `FF FF | id length | … | inverted sum, 8 bits`."""
    parts = [framing.sync.hex(" ").upper()] if framing.sync else []
    names = [head.name or "const" for head in framing.heads]
    if names:
        parts.append(" ".join(names))
    parts.append("…")
    if framing.check is not None:
        parts.append(framing.check.describe)
    if framing.end:
        also = f" or {framing.short_end.hex(' ').upper()}" if framing.short_end else ""
        parts.append(f"{framing.end.hex(' ').upper()}{also}")
    if framing.is_silent:
        parts.append("silence")
    if framing.stuffing is not None:
        parts.append(framing.stuffing.describe)
    return " | ".join(parts)


def print_check(out: SourceText, number: int, framing: Framing) -> None:
    """Print `check_N(packet)`; packets that are stuffed as a whole cannot be checked so."""
    check = framing.check
    assert check is not None
    text = check.text
    if text is not None and check.bytes == 1:
        out.lines(
            f'texts_{number} = [text_{number}.format(n).encode("ascii") for n in range(256)]',
            "",
        )
    out.line(f"def check_{number}(packet):")
    out.depth += 1
    out.line(f'"""Why the check of a packet fails ({comment_line(check.describe)}), or None."""')
    affine = framing.affine
    if affine is not None and affine.flags is not None:
        out.lines(
            f"if {_number_in(affine.flags)} & {affine.mask:#x}:",
            f"    packet = packet[:-{affine.more}]",
        )
    if any(isinstance(part, Extra) for part in check.over or ()):
        head = framing.extra_head
        assert head is not None
        out.lines(
            f"message = {_number_in(head)}",
            f"extra = extras_{number}(message)",
            "if extra is None:",
            "    return f'malformed: no message {message} to check by'",
        )
    found = computed(check, number, _covered(framing.check_over))
    wanted, stored = _wanted(check, number, found), _stored_in(framing, check)
    if check.digits is not None:
        out.lines(
            f"wanted = {wanted}",
            f"if {stored} != wanted and not same_{number}({stored}, wanted):",
        )
    else:
        out.line(f"if {wanted} != {stored}:")
    out.lines(
        "    return 'malformed: checksum'",
        "return None",
    )
    out.depth -= 1
    out.line()


def computed(check: Check, number: int, run: str) -> str:
    """Return the check's number over `run`, as an expression."""
    if isinstance(check, Sum):
        return f"{check.sign}sum({run}) & {check.mask:#x}"
    if isinstance(check, Fletcher):
        return f"fletcher({run})"
    if isinstance(check, Xor):
        return f"xor({run})"
    return f"crc_{number}({run})"


def _covered(over: Sequence[Covered]) -> str:
    parts = []
    for part in over:
        if isinstance(part, slice):
            parts.append(
                f"packet[{'' if part.start is None else part.start}:{'' if part.stop is None else part.stop}]"
            )
        elif isinstance(part, bytes):
            parts.append(literal(part))
        else:
            parts.append("extra")
    return " + ".join(parts)


def _wanted(check: Check, number: int, found: str) -> str:
    if check.text is None:
        return f"({found})" if "&" in found else found
    return (
        f"texts_{number}[{found}]" if check.bytes == 1 else f'text_{number}.format({found}).encode("ascii")'
    )


def _stored_in(framing: Framing, check: Check) -> str:
    """Return the check that a packet has, as an expression."""
    if framing.check_head is not None:
        return _number_in(framing.check_head)
    back = -framing.check_at
    end = f"-{back - check.size}" if back > check.size else ""
    if check.text is not None:
        return f"packet[-{back}:{end}]"
    if check.bytes == 1:
        return f"packet[-{back}]"
    if check.bytes == 2:
        low, high = (back, back - 1) if check.order == "little" else (back - 1, back)
        return f"(packet[-{low}] | packet[-{high}] << 8)"
    return f'from_bytes(packet[-{back}:{end}], "{check.order}")'
