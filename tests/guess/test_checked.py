"""Drafts that are tried before they are written."""

from __future__ import annotations

from collections.abc import Mapping

from aces_bus import Frame, FrameTable
from aces_lab.guess import FieldGuess, Traffic
from aces_lab.guess.checked import checked_draft
from aces_lab.guess.draft import field_name

HEAD = """from __future__ import annotations

from construct import Byte, GreedyBytes, Struct

from aces_bus.protocol import Protocol

draft = Protocol("draft", link="can")
"""


def source(as_bytes: Mapping[str, str], payloads: Mapping[str, str]) -> str:
    """A draft of these messages."""
    parts: list[str] = []
    for number, (name, payload) in enumerate(payloads.items()):
        said = 'Struct("data" / GreedyBytes)' if name in as_bytes else payload
        parts.append(f'draft.message(\n    "{name}",\n    id={0x100 + number},\n    payload={said},\n)')
    return "\n".join([HEAD, *parts, ""])


def test_a_message_that_does_not_load_is_bytes() -> None:
    """The others keep their fields."""
    payloads = {
        "Good": 'Struct("a" / Byte)',
        "Twice": 'Struct(\n        "a" / Byte,\n        "a" / Byte,\n    )',
    }
    draft = checked_draft(lambda some: source(some, payloads), "draft")
    assert list(draft.as_bytes) == ["Twice"]
    assert "declared twice" in draft.as_bytes["Twice"]
    assert not draft.wrong


def test_a_message_whose_frames_do_not_decode_is_bytes() -> None:
    """Tried on frames that it was guessed from."""
    frames = FrameTable.from_frames(Frame(0x100, bytes([n, 0]), n / 10) for n in range(20))
    traffic = Traffic()
    traffic.add(frames)
    [message] = traffic.guess(known=False).messages
    payloads = {message.name: 'Struct("a" / Byte)'}
    draft = checked_draft(lambda some: source(some, payloads), "draft", [message], frames)
    assert list(draft.as_bytes) == [message.name]
    assert draft.as_bytes[message.name].startswith("20 of its frames")


def test_what_is_wrong_beside_messages_is_said() -> None:
    """And nothing is declared as bytes for it."""
    draft = checked_draft(lambda _: "from construct import nothing_of_that_name\n", "draft")
    assert "nothing_of_that_name" in draft.wrong
    assert not draft.as_bytes


def test_fields_that_begin_at_one_bit_have_names_of_their_own() -> None:
    """One from a later byte on upward, one within the byte that the first one ends in."""
    down = FieldGuess(3 * 8 + 4, 6, "big", "number", 0.5, "")
    own = FieldGuess(2 * 8 + 4, 4, "little", "number", 0.5, "")
    assert (field_name(down), field_name(own)) == ("number_2_3_4", "number_2_4")
