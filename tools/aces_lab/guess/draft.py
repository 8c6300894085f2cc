"""A guess as the source of a spec: a draft to be edited, with its evidence in comments.

1. What is printed loads, passes `aces spec check`, and accounts for every frame that it was guessed from.
2. A constant in a recording is not a promise: bytes that never changed belong to no field, and are kept as `reserved`.
3. An enumeration has the values that occurred, named by their numbers; another one decodes to its number.
4. Nothing of a recording reaches the source but numbers and printable ASCII in comments.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from aces_bus.frames import EXTENDED, FD, REMOTE
from aces_bus.protocol.exchange.names import PythonNames

from .fields import FieldGuess
from .reference import ReferenceGuesses
from .traffic import MessageGuess, TrafficGuess

TITLE = '"""A draft by `aces spec guess`: yours to name and to correct from here on."""'
#: Columns of a comment, and of a field.
WIDTH = 110
#: What comes from aces_bus.protocol, and from construct.
_OURS = frozenset(
    (
        *("AsciiText", "BitLayout", "Cobs", "Counter", "Crc", "DataIds", "Delimited", "Enumeration"),
        *("Extra", "FastPacket", "Fletcher"),
        *(
            "IdBytes",
            "IdField",
            "Insert",
            "InvertedSum",
            "IsoTp",
            "J1939Transport",
            "Multiplexed",
            "Protocol",
            "Quantity",
        ),
        *("Slip", "Sum", "TailByte", "Text", "Xor", "bits", "float_bits"),
    )
)
_CONSTRUCTS = frozenset(
    ("Byte", "Bytes", "GreedyBytes", "Int16ub", "Int16ul", "Int32ub", "Int32ul", "Struct", "this")
)
_WORDS = re.compile(r"\b(?:" + "|".join(sorted(_OURS | _CONSTRUCTS)) + r")\b")
NOTHING: Mapping[str, str] = MappingProxyType({})
#: Names that `field_name` makes of kinds and places.
_PLACE = re.compile(r"[a-z]+(_\d+){1,3}(_at_\d+)?|rest")
#: Signs of evidence, in ASCII.
_ASCII = str.maketrans({"…": "..", "±": "+-", "−": "-"})
#: What is not a code: comments and texts.
_NO_CODE = re.compile(r"""#.*|b?'(?:[^'\\\n]|\\.)*'|b?"(?:[^"\\\n]|\\.)*\"""")


def draft_source(
    guess: TrafficGuess,
    name: str = "draft",
    files: Iterable[str] = (),
    as_bytes: Mapping[str, str] = NOTHING,
) -> str:
    """Return the module that declares what was guessed as the protocol `name`; `files` are named as where it comes from.

    Messages named in `as_bytes` are declared without their fields, for the reason that is given.
    Raises nothing for what is in the guess; a guess without messages becomes a protocol without any.
    """
    own = own_name(name)
    body: list[str] = []
    nodes: dict[str, str] = {}
    for message in guess.messages:
        body += ["", *_message(message, own, nodes, as_bytes.get(message.name))]
    head = [*_about(guess, files), "", *imports_of([*body, *nodes.values()])]
    return "\n".join([*head, f'{own} = Protocol("{own}", link="can")', *nodes.values(), *body, ""])


def imports_of(lines: Iterable[str]) -> list[str]:
    """Return the import statements of a draft whose other lines these are."""
    words = {"Protocol", *_WORDS.findall(_NO_CODE.sub("", "\n".join(lines)))}
    found = ["from __future__ import annotations", ""]
    for module, some in (("construct", words - _OURS), ("aces_bus.protocol", words & _OURS)):
        if some:
            ordered = sorted(some, key=lambda word: (not word[:1].isupper(), word))
            found += [f"from {module} import {', '.join(ordered)}", ""]
    return found


def own_name(name: str) -> str:
    """Return the name of a draft's protocol, that hides nothing which a draft uses."""
    return PythonNames.unused(name.lower(), set(_OURS | _CONSTRUCTS | PythonNames.TAKEN_BY_CODE))


def payload_lines(fields: Sequence[FieldGuess], size: int, trailing: bool = False) -> list[str]:
    """Return the payload of a message of `size` bytes as an expression over several lines, each field with its evidence.

    `trailing` says that bytes follow, as many as there are: they are the field `rest`.
    """
    if not size:
        return ['Struct("rest" / GreedyBytes)'] if trailing else []
    texts = [field for field in fields if field.kind == "text"]
    if not texts:
        return _layout(fields, 0, size, trailing)
    lines = ["Struct("]
    at = 0
    for text in [*texts, None]:
        end = size if text is None else text.first_byte
        if end > at:
            inner = [field for field in fields if at <= field.first_byte < end and field.kind != "text"]
            layout = _layout(inner, at, end - at, False)
            lines += [f'    "bytes_{at}" / {layout[0]}', *(f"    {line}" for line in layout[1:])]
            lines[-1] += ","
        if text is not None:
            lines += _commented(text, f'"{field_name(text)}" / Text({text.length // 8}),')
            at = end + text.length // 8
    if trailing:
        lines.append('    "rest" / GreedyBytes,')
    return [*lines, ")"]


def data_lines(why: str) -> list[str]:
    """Return a payload that is bytes, and why."""
    return [
        "Struct(",
        *wrapped(plain(f"The fields that were guessed are left out: {why}"), "    # ", "    # "),
        '    "data" / GreedyBytes,',
        ")",
    ]


def field_name(field: FieldGuess) -> str:
    """Return what a field is called: its kind and where it is, by byte and, where that is not its first, bit. One whose
    lowest bit is in a later byte, and not the first there, has both bytes: another may begin at that bit of the first.
    """
    bit = field.start % 8
    if field.measured is not None:
        return _measured_name(field.measured.name)
    if field.kind == "multiplexer":
        return f"{field.kind}_{field.first_byte}"
    when = f"_at_{field.when[0]}" if field.when else ""
    later = f"_{field.start // 8}" if bit and field.start // 8 != field.first_byte else ""
    return f"{field.kind}_{field.first_byte}{later}" + (f"_{bit}" if bit or field.length < 8 else "") + when


def _measured_name(name: str) -> str:
    """Return the name of a quantity as one of a field, apart from those that are made of kinds and places."""
    made = PythonNames.unused(name, set(PythonNames.TAKEN_BY_CODE | PythonNames.TAKEN_BY_RECORDS))
    return f"{made}_" if _PLACE.fullmatch(made) else made


# ---------------------------------------------------------------------- the head


def _about(guess: TrafficGuess, files: Iterable[str]) -> Iterator[str]:
    yield from (TITLE, "")
    said = [f"Guessed from {guess.kept:,} frames" + "".join(f", {plain(file)}" for file in files) + "."]
    if guess.kept < guess.frames - guess.errors:
        said[0] += f" The recording has {guess.frames:,}."
    if guess.known:
        best = guess.known[0]
        said.append(f"{guess.decoded:,} of these frames are {best.name}, and are not in here.")
    if guess.reference is not None:
        said += reference_said(guess.reference)
    said += [f"{protocol.name}: {protocol.evidence}" for protocol in guess.protocols]
    said += [f"{_shown(pair.reply)} answers {_shown(pair.request)}: {pair.evidence}" for pair in guess.pairs]
    for line in said:
        yield from wrapped(plain(line), "# ", "#   ")


def reference_said(reference: ReferenceGuesses) -> Iterator[str]:
    """Yield a sentence on a quantity, and one for each field that follows it."""
    name = plain(reference.quantity.name)
    clock = "on the recording's clock" if reference.is_same_clock else "taken to begin with the recording"
    verdict = "is the first of these" if reference.found is not None else "is none of these for sure"
    verdict = verdict if reference.guesses else "is in no field"
    yield f"{name}, {len(reference.quantity.values):,} instants {clock}, {verdict}."
    for guess in reference.guesses:
        field = guess.field
        yield f"{guess.shown} bits {place_text(field)}, {integer_text(field)}: {field.evidence}"


def place_text(field: FieldGuess) -> str:
    """Return the first and the last bit of a field, as byte and bit."""
    first, last = field.positions[0], field.positions[-1]
    return f"{first // 8}.{first % 8}" + (f"…{last // 8}.{last % 8}" if first != last else "")


def integer_text(field: FieldGuess) -> str:
    """Return sign, length and, over several bytes, byte order of a number: `s12 big`."""
    first, last = field.positions[0], field.positions[-1]
    return f"{'s' if field.signed else 'u'}{field.length}" + (
        f" {field.order}" if first // 8 != last // 8 else ""
    )


def _shown(key: int) -> str:
    return f"{key & 0x1FFF_FFFF:0{8 if key & EXTENDED else 3}X}"


def plain(text: str) -> str:
    """Return foreign text as one line of ASCII."""
    text = text.translate(_ASCII)
    return "".join(c if " " <= c < "\x7f" else "?" for c in text)


def wrapped(text: str, first: str, others: str) -> list[str]:
    """Return a comment, or code without texts, in lines that are not wider than `WIDTH` where there are blanks."""
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=first,
        subsequent_indent=others,
        break_on_hyphens=False,
        break_long_words=False,
    )


# ---------------------------------------------------------------------- messages


def _message(message: MessageGuess, own: str, nodes: dict[str, str], why_bytes: str | None) -> Iterator[str]:
    key = message.keys[0]
    said = f"{message.shown}: {message.frames:,} frames"
    if message.timing is not None and message.frames > 2:
        rate = f"every {message.timing.period_ns / 1e6:.4g} ms"
        said += f", {rate}" if message.timing.is_regular else f", at no fixed rate (mostly {rate})"
    if message.node is not None:
        said += f"; {message.node.evidence} ({message.node.confidence:.2f})"
    yield from wrapped(said, "# ", "# ")
    fields = _named_once(message.fields)
    for line in _constants(fields):
        yield from wrapped(line, "# ", "#   ")
    digits = 8 if key & EXTENDED else 3
    identifier = f"0x{message.identifier:0{digits}X}"
    if message.node is not None:
        node = message.node
        values = _values(node.numbers)
        variable = nodes_name(nodes, node.name, values)
        capture = f"{variable} << {node.shift}" if node.shift else variable
        identifier = (
            f"0x{node.base:0{digits}X} + ({capture})"
            if node.shift
            else f"0x{node.base:0{digits}X} + {capture}"
        )
    yield f"{own}.message("
    yield f'    "{message.name}",'
    yield f"    id={identifier},"
    for flag, word in ((EXTENDED, "extended"), (FD, "fd"), (REMOTE, "remote")):
        if key & flag:
            yield f"    {word}=True,"
    if message.transport:
        yield f"    transport={message.transport},"
    elif not key & REMOTE:
        yield f"    length={message.length if message.length is not None else _values(message.lengths)},"
    lines = payload_lines(fields, message.size, message.length is None)
    if why_bytes is not None:
        lines = data_lines(why_bytes)
    if lines:
        lines[-1] += ","
        yield f"    payload={lines[0]}"
        yield from (f"    {line}" for line in lines[1:])
    check = next((field for field in fields if field.check is not None), None)
    if (
        why_bytes is None
        and check is not None
        and check.check is not None
        and not any(field.kind == "text" for field in fields)
    ):
        yield f"    check={check.check.declare(field_name(check))},"
    yield ")"


def nodes_name(nodes: dict[str, str], name: str, values: str) -> str:
    """Return the variable that holds a captured part with these values; a new one is entered in `nodes`, with its line."""
    for variable, line in nodes.items():
        if line == f'{variable} = IdField("{name}", {values})':
            return variable
    number = sum(variable.startswith(name.capitalize()) for variable in nodes)
    variable = name.capitalize() + (str(number + 1) if number else "")
    nodes[variable] = f'{variable} = IdField("{name}", {values})'
    return variable


def _values(numbers: Sequence[int]) -> str:
    """Return numbers as a range where they are one, else as a tuple."""
    numbers = sorted(set(numbers))
    if len(numbers) > 1 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"range({numbers[0]}, {numbers[-1] + 1})" if numbers[0] else f"range({numbers[-1] + 1})"
    return f"({', '.join(map(str, numbers))}{',' if len(numbers) == 1 else ''})"


def _constants(fields: Iterable[FieldGuess]) -> Iterator[str]:
    for field in fields:
        if field.kind == "constant":
            first, last = field.first_byte, (field.start + field.length - 1) // 8
            where = f"byte {first}" if first == last else f"bytes {first} to {last}"
            if field.length % 8:
                low = field.start % 8
                where += f" bit {low}" if field.length == 1 else f" bits {low} to {low + field.length - 1}"
            yield f"{where}: {field.evidence}"


def _named_once(fields: Iterable[FieldGuess]) -> list[FieldGuess]:
    """Keep the first check of a message; turn further checks into numbers."""
    found: list[FieldGuess] = []
    has_check = False
    for field in fields:
        if field.kind == "check" and has_check:
            field = replace(field, kind="number")
        has_check = has_check or field.kind == "check"
        found.append(field)
    return found


# ---------------------------------------------------------------------- fields


def _layout(fields: Sequence[FieldGuess], first: int, size: int, trailing: bool) -> list[str]:
    """Return a `BitLayout` of these fields, of `size` bytes from byte `first` on."""
    some = [field for field in fields if field.kind != "constant"]
    multibyte = [field.order for field in some if field.positions[0] // 8 != field.positions[-1] // 8]
    is_big = multibyte.count("big") > len(multibyte) / 2
    lines = ["BitLayout(", f"    {size},"]
    # A selector comes before what it selects.
    for field in sorted(some, key=lambda field: field.kind != "multiplexer"):
        lines += _commented(field, f'"{field_name(field)}" / {_field(field, first, is_big)},')
    if is_big:
        lines.append('    order="msb",')
    if trailing:
        lines.append('    trailing="rest",')
    return [*lines, ")"]


def _commented(field: FieldGuess, code: str) -> list[str]:
    text = f"{field.evidence} ({field.confidence:.2f})"
    return [f"    {line}" for line in (*wrapped(plain(text), "# ", "# "), *wrapped(code, "", "    "))]


def _field(field: FieldGuess, first: int, is_big: bool) -> str:
    spans = field.positions[0] // 8 != field.positions[-1] // 8
    is_msb = field.order == "big" if spans else is_big
    at = (field.positions[-1] ^ 7 if is_msb else field.positions[0]) - 8 * first
    arguments = f"{field.length}, {at}"
    order = "" if is_msb == is_big else f', order="{"msb" if is_msb else "lsb"}"'
    if field.kind == "float":
        made = f"float_bits({arguments}{order})"
    else:
        made = f"bits({arguments}{', signed=True' if field.signed else ''}{order})"
    if field.kind == "counter" and field.value == 1 and field.modulus:
        made = f"Counter({made}{f', {field.modulus}' if field.modulus != 1 << field.length else ''})"
    if field.kind == "enumeration" and field.values:
        made = f"Enumeration({made}, {', '.join(f'value_{value}={value}' for value in field.values)})"
    if field.measured is not None:
        measured = field.measured
        said = f'unit="{measured.unit}", ' if measured.unit else ""
        offset = f", offset={measured.offset!r}" if measured.offset else ""
        made = f"Quantity({made}, {said}scale={measured.scale!r}{offset})"
    if field.when:
        made = f'Multiplexed("{field.selector}", {_set(field.when)}, {made})'
    return made


def _set(values: Sequence[int]) -> str:
    return str(values[0]) if len(values) == 1 else f"{{{', '.join(map(str, values))}}}"
