"""Whole databases drawn at random, written as DBC, read back by cantools and by us: every value of every frame agrees.

1. cantools is the oracle, for records and for columns: its own reading of the text, not the objects that the text was
   made of.
2. A frame of up to 8 bytes comes in either format, classic or CAN FD: the values are the same.
3. Values agree by `==`, floats to the last bit; what cantools refuses (a multiplexer value that no signal is for) still
   decodes here, and is not compared.
"""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from aces_bus import Frame, FrameTable, Unknown, make_column_scanner
from aces_bus.protocol import Protocol
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.record import field_names

cantools = pytest.importorskip("cantools")

SCALES: tuple[float, ...] = (1, 2, -1, 3, 0.5, 0.1, 1e-3, -0.25, 0.00390625, 1.0e7, 7.3)
OFFSETS: tuple[float, ...] = (0, 0, 1, -40, 0.5, -100.25, 1e6)
#: Lengths of data: mostly classic, some of FD.
SIZES = (8, 8, 8, 1, 2, 3, 5, 7, 0, 12, 24, 64)


#: What multiplexers must have for a signal to be there: (name, values), outermost first.
Chain = tuple[tuple[str, tuple[int, ...]], ...]


def _exclude(one: Chain, other: Chain) -> bool:
    """Whether two signals are never there together."""
    mine = dict(one)
    return any(name in mine and not set(mine[name]) & set(values) for name, values in other)


def _mask(at: int, width: int, is_big: bool) -> int:
    return sum(1 << (p ^ 7 if is_big else p) for p in range(at, at + width))


@st.composite
def signals(draw: st.DrawFn, size: int) -> list[dict[str, Any]]:
    """Signals that share no bits while they are there together: keywords of `cantools.database.can.Signal`."""
    found: list[dict[str, Any]] = []
    placed: list[tuple[int, Chain]] = []
    levels: list[Chain] = [()]
    for number in range(draw(st.integers(0, 8))):
        chain = draw(st.sampled_from(levels[::-1]))
        is_float = draw(st.integers(0, 5)) == 0
        width = draw(st.sampled_from((32, 64))) if is_float else draw(st.integers(1, 16))
        if not is_float and draw(st.integers(0, 7)) == 0:
            width = draw(st.integers(17, 64))
        is_selector = not is_float and len(levels) < 8 and draw(st.booleans())
        width = min(width, 6) if is_selector else width
        is_big = draw(st.booleans())
        used = 0
        for mask, other in placed:
            used |= mask if not _exclude(chain, other) else 0
        places = [at for at in range(8 * size - width + 1) if not _mask(at, width, is_big) & used]
        if not places:
            continue
        at = draw(st.sampled_from(places))
        placed.append((_mask(at, width, is_big), chain))
        name = f"s{number}"
        scale = 1 if is_selector else draw(st.sampled_from(SCALES))
        offset = 0 if is_selector else draw(st.sampled_from(OFFSETS))
        signed = not is_selector and draw(st.booleans())
        choices = None
        if not is_float and draw(st.integers(0, 3)) == 0:
            low, high = (-(1 << width - 1), (1 << width - 1) - 1) if signed else (0, (1 << width) - 1)
            values = draw(st.lists(st.integers(low, high), min_size=1, max_size=4, unique=True))
            choices = {value: f"name {index}" for index, value in enumerate(values)}
        found.append(
            {
                "name": name,
                "start": 8 * (at // 8) + 7 - at % 8 if is_big else at,
                "length": width,
                "byte_order": "big_endian" if is_big else "little_endian",
                "is_signed": signed,
                "is_multiplexer": is_selector,
                "multiplexer_signal": chain[-1][0] if chain else None,
                "multiplexer_ids": list(chain[-1][1]) if chain else None,
                "unit": draw(st.sampled_from((None, "V", "°C"))),
                "comment": draw(st.sampled_from((None, "says ''' and \\ too", "two\nlines"))),
                "of": (scale, offset, is_float, choices),
            }
        )
        if is_selector:
            top = (1 << width) - 1
            for _ in range(draw(st.integers(1, 2))):
                first = draw(st.integers(0, min(top, 5)))
                last = draw(st.integers(first, min(top, first + 3)))
                levels.append((*chain, (name, tuple(range(first, last + 1)))))
    return found


@st.composite
def databases(draw: st.DrawFn) -> str:
    """The text of a DBC file."""
    from cantools.database import Database
    from cantools.database.can import Message, Signal
    from cantools.database.conversion import BaseConversion

    messages: list[Any] = []
    for number in range(draw(st.integers(1, 3))):
        size = draw(st.sampled_from(SIZES))
        made = []
        for one in draw(signals(size)):
            scale, offset, is_float, choices = one.pop("of")
            conversion = BaseConversion.factory(scale, offset, choices, is_float)
            made.append(Signal(conversion=conversion, **one))
        extended = draw(st.booleans())
        identifier = draw(st.integers(0, 0x1FFF_FFFF if extended else 0x7FF))
        if any(m.frame_id == identifier and m.is_extended_frame == extended for m in messages):
            continue
        messages.append(
            Message(identifier, f"m{number}", size, made, is_extended_frame=extended, strict=False)
        )
    return str(Database(messages).as_dbc_string())


def _same(mine: Any, theirs: Any) -> bool:
    if isinstance(mine, float) and isinstance(theirs, float) and math.isnan(mine):
        return math.isnan(theirs)
    return bool(mine == theirs)


def agree(path: Path, frames: int, seed: int) -> int:
    """Assert that cantools and we agree on random frames of a file; how many signal values were compared."""
    database = cantools.database.load_file(str(path), strict=False)
    protocol = load_database(path).protocol
    physical, raw = (_scanner(protocol, is_raw) for is_raw in (False, True))
    rng = random.Random(seed)
    compared = 0
    frames_seen: list[Frame] = []
    records: list[Any] = []
    for message in database.messages:
        for _ in range(frames):
            most = 8 if message.length <= 8 else 64
            size = (
                message.length
                if rng.random() < 0.8 or message.length > 8
                else rng.randint(message.length, most)
            )
            data = rng.choice((rng.randbytes(size), bytes(rng.choice((0, 1, 2, 255)) for _ in range(size))))
            if message.length > 8 and size not in (12, 24, 64):
                continue
            frame = Frame(
                message.frame_id,
                data,
                is_extended_id=message.is_extended_frame,
                is_fd=len(data) > 8 or rng.random() < 0.3,
            )
            (shown,), (bare,) = physical.feed([frame]), raw.feed([frame])
            assert not isinstance(shown, Unknown), (shown, message)
            frames_seen.append(frame)
            records.append(shown)
            try:
                named = message.decode(data, decode_choices=True)
                plain = message.decode(data, decode_choices=False)
                numbers = message.decode(data, decode_choices=False, scaling=False)
            except cantools.database.errors.DecodeError:
                continue
            for signal in message.signals:
                mine, mine_raw = getattr(shown, signal.name), getattr(bare, signal.name)
                if signal.name not in named:
                    assert mine is None, (signal.name, mine)
                    assert mine_raw is None
                    continue
                compared += 1
                wanted = named[signal.name]
                if type(wanted).__name__ == "NamedSignalValue":
                    assert mine == str(wanted), (signal, data.hex())
                else:
                    assert _same(mine, wanted), (signal, data.hex(), mine, wanted)
                    assert _same(mine, plain[signal.name])
                assert _same(mine_raw, numbers[signal.name]), (signal, data.hex())
            _encodes(protocol, message, shown, frame, named)
    _columns_agree(protocol, frames_seen, records)
    return compared


def _columns_agree(protocol: Protocol, frames: list[Frame], records: list[Any]) -> None:
    """The same frames as columns: value for value what the records show."""
    scanner = make_column_scanner([protocol.variant()])
    tables = scanner.feed(FrameTable.from_frames(frames)) + scanner.close()
    assert sum(len(table) for table in tables) == len(records)
    for table in tables:
        for name in table.names:
            shown = [getattr(records[row], name) for row in table.row.tolist()]
            assert all(map(_same, table[name].to_list(), shown)), (table.message, name)


def _encodes(protocol: Protocol, message: Any, record: Any, frame: Frame, named: Any) -> None:
    """What was decoded is built again: by us to the same bytes, by cantools to the same bytes but those of no signal."""
    fields = {name: getattr(record, name) for name in field_names(type(record))}
    built = protocol.encode(record.meta.message, **fields)
    floats = [s.name for s in message.signals if s.conversion.is_float]
    if any(isinstance(fields[name], float) and not math.isfinite(fields[name]) for name in floats):
        return
    is_exact = all(_is_exact(signal, fields[signal.name]) for signal in message.signals)
    if not is_exact:
        return
    assert bytes(built.data) == frame.data
    plain = {name: value for name, value in fields.items() if name not in ("reserved", "trailing")}
    ours = protocol.encode(record.meta.message, **plain)
    assert bytes(ours.data) == message.encode(named, strict=False)


def _is_exact(signal: Any, value: Any) -> bool:
    """Whether a scaled value leads back to its number: not so for floats, and for more bits than a float has."""
    conversion = signal.conversion
    if conversion.scale == 1 and conversion.offset == 0:
        return True
    return not conversion.is_float and (signal.length < 40 or isinstance(value, int))


def _scanner(protocol: Protocol, raw: bool) -> Any:
    from aces_bus import make_scanner

    return make_scanner([protocol.variant()], include_unknown=True, raw=raw)


@pytest.mark.slow
@given(text=databases(), seed=st.integers(0, 2**32))
def test_every_value_is_that_of_cantools(
    text: str, seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Byte orders, signs, scales, floats, value tables, multiplexers in multiplexers, classic and FD lengths."""
    path = tmp_path_factory.getbasetemp() / "drawn.dbc"
    path.write_text(text, encoding="utf-8")
    agree(path, frames=6, seed=seed)


# ---------------------------------------------------------------------- identifiers


@st.composite
def groups(draw: st.DrawFn) -> dict[int, str]:
    """Identifiers of J1939 messages, some of one parameter group from several sources, and the messages' names."""
    found: dict[int, str] = {}
    for group in draw(
        st.lists(st.sampled_from((0xFEC4, 0xFF12, 0xEF00, 0x0500)), min_size=1, max_size=3, unique=True)
    ):
        for source in draw(st.lists(st.integers(0, 253), min_size=1, max_size=4, unique=True)):
            found[6 << 26 | group << 8 | source] = f"m{len(found)}"
    return found


def text_of(messages: dict[int, str], mark: int, more: str = "") -> str:
    """A DBC file in which each message has one signal, by which it can be told."""
    lines = ['VERSION ""', "BU_: A"]
    for identifier, name in messages.items():
        lines += [f"BO_ {identifier | mark} {name}: 8 A", f' SG_ of_{name} : 0|16@1+ (0.5,0) [0|0] "" A']
    return "\n".join([*lines, more, ""])


J1939 = 'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";'


def identified(path: Path, text: str, frames: list[Frame]) -> list[Any]:
    """The records that frames are with a file."""
    path.write_text(text, encoding="utf-8")
    return list(_scanner(load_database(path).protocol, raw=False).feed(frames))


@pytest.mark.slow
@given(messages=groups(), data=st.binary(min_size=8, max_size=8))
def test_a_declared_source_has_its_own_message(
    messages: dict[int, str], data: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A frame with a declared identifier is the message that cantools finds, whatever else is in its parameter group; one
    from a source that no message has is never a message of another group."""
    text = text_of(messages, 1 << 31, J1939)
    path = tmp_path_factory.getbasetemp() / "groups.dbc"
    database = cantools.database.load_string(text, "dbc")
    frames = [Frame(identifier, data, is_extended_id=True) for identifier in messages]
    for frame, record in zip(frames, identified(path, text, frames), strict=True):
        theirs = database.get_message_by_frame_id(frame.arbitration_id)
        assert record.meta.message == theirs.name
        assert getattr(record, f"of_{theirs.name}") == theirs.decode(data)[f"of_{theirs.name}"]
    alone = next(n for n in range(254) if all(identifier & 0xFF != n for identifier in messages))
    others = [Frame(identifier & ~0xFF | alone, data, is_extended_id=True) for identifier in messages]
    for frame, record in zip(others, identified(path, text, others), strict=True):
        group = {
            name for identifier, name in messages.items() if identifier >> 8 == frame.arbitration_id >> 8
        }
        assert isinstance(record, Unknown) or record.meta.message in group


@given(
    identifiers=st.lists(
        st.integers(0x800, 0x1FFF_FFFF) | st.integers(0, 0x7FF), min_size=1, max_size=5, unique=True
    ),
    data=st.binary(min_size=8, max_size=8),
)
def test_wide_identifiers_without_the_flag(
    identifiers: list[int], data: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Without bit 31 an identifier of more than 11 bits is one of 29 bits: what cantools reads of the file with the bit set
    is what we read of it without; shorter ones stay 11 bits, and no frame of the other format is the message."""
    messages = {identifier: f"m{number}" for number, identifier in enumerate(identifiers)}
    path = tmp_path_factory.getbasetemp() / "wide.dbc"
    marked = text_of({n | (1 << 31 if n > 0x7FF else 0): name for n, name in messages.items()}, 0)
    database = cantools.database.load_string(marked, "dbc")
    frames = [Frame(n, data, is_extended_id=n > 0x7FF) for n in identifiers]
    for frame, record in zip(frames, identified(path, text_of(messages, 0), frames), strict=True):
        theirs = database.get_message_by_frame_id(frame.arbitration_id)
        assert theirs.is_extended_frame == frame.is_extended_id
        assert record.meta.message == theirs.name
        assert getattr(record, f"of_{theirs.name}") == theirs.decode(data)[f"of_{theirs.name}"]
    short = [Frame(n, data, is_extended_id=True) for n in identifiers if n <= 0x7FF]
    assert all(isinstance(one, Unknown) for one in identified(path, text_of(messages, 0), short))
