"""Prints the check of a framing's packets: a function that says why a packet's check fails, or None.

1. It reads what stands on the wire, and agrees with `Framing.judge`.
2. The names it uses: `crc_N`, `xor`, `fletcher` (numbers of bytes), `extras_N` (a message's bytes by its number),
   `text_N` (how a number is written), `texts_N` (numbers as characters), `same_N` (whether characters are the same number).
"""

from __future__ import annotations

from ..declare.checks import Check, Extra, Fletcher, Sum, Xor
from ..declare.framing import Framing
from .names import literal
from .source import SourceText, comment_line


def print_check(out: SourceText, number: int, framing: Framing) -> None:
    """`check_N(packet)`; packets that are stuffed as a whole cannot be checked so."""
    check = framing.check
    assert check is not None
    back = check.size + len(framing.end)
    text = check.text
    if text is not None and check.bytes == 1:
        out.line(f'texts_{number} = [text_{number}.format(n).encode("ascii") for n in range(256)]')
        out.line()
    out.line(f"def check_{number}(packet):")
    out.depth += 1
    out.line(f'"""Why the check of a packet fails ({comment_line(check.describe)}), or None."""')
    if any(isinstance(part, Extra) for part in check.over or ()):
        head = framing.extra_head
        assert head is not None
        key = f"packet[{head.offset}]"
        if head.size > 1:
            key = f'from_bytes(packet[{head.offset}:{head.offset + head.size}], "{head.order}")'
        out.line(f"message = {key}")
        out.line(f"extra = extras_{number}(message)")
        out.line("if extra is None:")
        out.line("    return f'malformed: no message {message} to check by'")
    found = computed(check, number, _covered(check, len(framing.sync), back))
    wanted, stored = _wanted(check, number, found), _stored(check, back)
    if check.digits is not None:
        out.line(f"wanted = {wanted}")
        out.line(f"if {stored} != wanted and not same_{number}({stored}, wanted):")
    else:
        out.line(f"if {wanted} != {stored}:")
    out.line("    return 'malformed: checksum'")
    out.line("return None")
    out.depth -= 1
    out.line()


def computed(check: Check, number: int, run: str) -> str:
    """The check's number over `run`, as an expression."""
    if isinstance(check, Sum):
        return f"{'~' if check.inverted else ''}sum({run}) & {check.mask:#x}"
    if isinstance(check, Fletcher):
        return f"fletcher({run})"
    if isinstance(check, Xor):
        return f"xor({run})"
    return f"crc_{number}({run})"


def _covered(check: Check, sync: int, back: int) -> str:
    if check.over is None:
        return f"packet[{sync}:-{back}]"
    parts = []
    for part in check.over:
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


def _stored(check: Check, back: int) -> str:
    """What stands `back` bytes before the packet's end, as an expression."""
    end = f"-{back - check.size}" if back > check.size else ""
    if check.text is not None:
        return f"packet[-{back}:{end}]"
    if check.bytes == 1:
        return f"packet[-{back}]"
    if check.bytes == 2:
        low, high = (back, back - 1) if check.order == "little" else (back - 1, back)
        return f"(packet[-{low}] | packet[-{high}] << 8)"
    return f'from_bytes(packet[-{back}:{end}], "{check.order}")'


__all__ = ["computed", "print_check"]
