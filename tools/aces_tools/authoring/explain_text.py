"""An explanation as lines for a terminal: a line a part, below it who died and why, in front what was read.

1. Nothing is cut off; what has no room goes on in the next line, indented.
2. Many deaths for one reason are one line; few are named each.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from aces_bus.protocol.explain.attempt import Attempt, Death, FieldRead, Step
from aces_bus.protocol.lint.examples import show_value
from aces_bus.protocol.record import plain_value

from ..output.text import Paint

#: A run of so many parts of one field is one line.
LONG = 5
#: So many deaths at a byte are listed one by one.
NAMED = 3
#: The lines of templates never get narrower than this.
NARROW = 24


def attempt_lines(attempt: Attempt, width: int | None, paint: Paint) -> list[str]:
    """Return the lines that explain one attempt."""
    found = attempt.found
    head = paint("source", attempt.label)
    if not attempt.is_can and attempt.run == 1 and len(attempt.raw) > 1:
        room = len(attempt.raw) if width is None else max(1, (width - len(attempt.label) - 2) // 3)
        shown = attempt.raw[:room].hex(" ").upper() if len(attempt.raw) <= room else ""
        head += paint("raw", f"  {shown}") if shown and len(attempt.raw) <= 24 else ""
    lines = [head]
    if attempt.run > 1 and found.message is None:
        lines += _wrapped(f"{_hex(attempt.raw)}: no packet begins here", "  ", width)
        lines.append(
            f"  {paint(_style(found.reason), found.reason)}; the search goes on at offset {attempt.resumes}"
        )
        return lines
    place = max((len(step.place) for step in attempt.steps), default=0)
    part = max((len(step.part) for step in attempt.steps), default=0)
    what = min(18, max((len(step.what) for step in attempt.steps), default=0))
    for number, steps in enumerate(_grouped(attempt.steps)):
        if attempt.left_out and steps[-1] is attempt.steps[-1]:
            lines.append(f"  {'…':>{place}}  {attempt.left_out} more bytes")
        if len(steps) > 1:
            front = f"  {steps[0].place:>{place}}  "
            texts = " ".join(step.part for step in steps)
            lines += _wrapped(
                f"{steps[0].what}, {len(steps)} bytes: {texts}", front, width, hang=" " * len(front)
            )
            continue
        lines += _step(steps[0], (place, part, what), len(attempt.templates), width, paint, number == 0)
    return lines + _verdict(attempt, width, paint)


def _grouped(steps: Sequence[Step]) -> Iterator[list[Step]]:
    """Yield parts by themselves, and long runs of one field in which nothing happens together."""
    run: list[Step] = []
    for step in steps:
        is_quiet = bool(step.what) and not step.died and not step.read
        if run and is_quiet and step.what == run[0].what:
            run.append(step)
            continue
        yield from [run] if len(run) >= LONG else [[single] for single in run]
        run = [step] if is_quiet else []
        if not is_quiet:
            yield [step]
    yield from [run] if len(run) >= LONG else [[single] for single in run]


def _step(
    step: Step, sizes: tuple[int, int, int], every: int, width: int | None, paint: Paint, is_first: bool
) -> list[str]:
    place, part, what = sizes
    front = f"  {step.place:>{place}}  "
    plain_front = f"{front}{step.part:<{part}}  "
    is_narrow = width is not None and width - len(plain_front) - what < NARROW
    label = step.what if is_narrow else f"{step.what:<{what}}"
    text = paint("name", front) + paint("message", f"{step.part:<{part}}") + "  " + label
    read = ", ".join(_reading(reading) for reading in step.read)
    notes: list[tuple[str, str]] = [("from device", read)] if read else []
    notes += [("skipped", f"✗ {death}") for death in _deaths(step.died)]
    if step.died and step.alive:
        notes.append(("value", _alive(step.alive)))
    elif is_first and every > 1:
        notes.append(("value", f"○ {len(step.alive)} of {every} templates are possible"))
    indent = " " * (4 if is_narrow else len(plain_front) + what + 2)
    lines: list[str] = []
    for style, note in notes:
        lines += [indent + paint(style, line.strip()) for line in _wrapped(note, indent, width)]
    if lines and not is_narrow:  # the first note goes beside its byte
        return [f"{text}  {lines[0][len(indent) :]}", *lines[1:]]
    return [text.rstrip(), *lines]


def _reading(reading: FieldRead) -> str:
    unit = f" {reading.unit}" if reading.unit and isinstance(reading.value, (int, float)) else ""
    owner = f"{reading.template}." if reading.template else ""
    value = plain_value(reading.value)
    shown = _hex(value) if isinstance(value, bytes) and value else show_value(value)
    return f"{owner}{reading.name} = {shown}{unit}"


def _alive(names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"○ {names[0]} is left"
    if len(names) <= 6:
        return f"○ possible: {', '.join(names)}"
    return f"○ {len(names)} are possible: {', '.join(names[:5])}, …"


def _deaths(died: Sequence[Death]) -> Iterable[str]:
    if not died:
        return
    if len(died) <= NAMED:
        by_detail: dict[tuple[str, str], list[str]] = {}
        for death in died:
            by_detail.setdefault((death.why, death.detail), []).append(death.template)
        for (why, detail), names in by_detail.items():
            yield f"{', '.join(names)}: {_because(why, detail)}"
        return
    by_why: dict[str, list[Death]] = {}
    for death in died:
        by_why.setdefault(death.why, []).append(death)
    for why, deaths in by_why.items():
        details = list(dict.fromkeys(death.detail for death in deaths))
        names = [death.template for death in deaths]
        listed = ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:4])} and {len(names) - 4} more"
        if len(details) == 1:
            yield f"{listed}: {_because(why, details[0])}"
        else:
            yield f"{listed}: {_because(why, _wanted(details))}"


def _because(why: str, detail: str) -> str:
    """Return a reason as a phrase; some classes say it all in their details."""
    return detail if why in ("request", "order") else f"{why} {detail}".rstrip()


def _wanted(details: Sequence[str]) -> str:
    """Return what was wanted each time, and what came, once, behind them."""
    parts = [detail.rpartition(", not ") for detail in details]
    came = {part[2] for part in parts if part[1]}
    is_same = len(came) == 1 and all(part[1] for part in parts)
    wanted = list(dict.fromkeys(part[0] for part in parts)) if is_same else list(details)
    shown = ", ".join(wanted[:4]) + (", …" if len(wanted) > 4 else "")
    return f"{shown}, not {came.pop()}" if is_same else shown


def _verdict(attempt: Attempt, width: int | None, paint: Paint) -> list[str]:
    """Return what was decided, and where the search goes on."""
    found = attempt.found
    goes_on = "" if attempt.is_can else f"the search goes on at offset {attempt.resumes}"
    if found.message is None:
        if found.reason == "pending":
            goes_on = "the bytes end before the packet does"
        first, *more = _wrapped(
            f"→ {found.reason}{f'; {goes_on}' if goes_on else ''}", "  ", width, hang="  "
        )
        return [first.replace(found.reason, paint(_style(found.reason), found.reason), 1), *more]
    name = found.message if found.protocol is None else f"{found.protocol}.{found.message}"
    first, *more = _wrapped(f"→ {name}({_listed(found.fields or {})})", "  ", width, hang="    ")
    lines = [first.replace(name, paint("message", name), 1), *more]
    if attempt.request is not None:
        asked, values = attempt.request
        lines += _wrapped(f"answers {asked}({_listed(values)})", "    ", width, hang="  ")
    return [*lines, f"    {goes_on}"] if goes_on else lines


def _listed(fields: Mapping[str, Any]) -> str:
    return ", ".join(f"{k}={show_value(plain_value(v))}" for k, v in fields.items() if not k.startswith("_"))


def _style(reason: str) -> str:
    kind = reason.partition(":")[0]
    return kind if kind in ("unknown", "malformed", "skipped", "pending") else "errors"


def _hex(data: bytes) -> str:
    return data[:24].hex(" ").upper() + (f" … ({len(data)} bytes)" if len(data) > 24 else "")


def _wrapped(text: str, indent: str, width: int | None, hang: str = "") -> list[str]:
    if width is None or len(indent) + len(text) <= width:
        return [indent + text]
    return textwrap.wrap(
        text,
        max(width, NARROW),
        initial_indent=indent,
        subsequent_indent=hang if indent.strip() else indent + hang,
        break_long_words=False,
        break_on_hyphens=False,
    )
