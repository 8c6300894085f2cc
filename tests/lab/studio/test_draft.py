"""The spec that is drawn: fields over bits, the file that they become, and what was written in it by others."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from aces_bus import Frame, FrameTable, load_protocol
from aces_bus.errors import CallerError
from aces_bus.frames import EXTENDED
from aces_lab.studio.capture import Capture
from aces_lab.studio.draft import Draft, DrawnMessage
from aces_lab.studio.fields import BitOrder, DrawnField, dragged, in_order

SPEED = DrawnField("speed", 0, 16, "little", True, 0.01, 0.0, "rad/s")
TORQUE = DrawnField("torque", 28, 12, "big", False, 0.5, -10.0, "N m")
FLAG = DrawnField("flag", 40, 1)


@pytest.fixture
def draft(tmp_path: Path) -> Draft:
    return Draft(str(tmp_path / "car.py"))


def drawn(*fields: DrawnField, key: int = 0x123, name: str = "Motor") -> DrawnMessage:
    message = DrawnMessage(name, key, 8)
    for field in fields:
        message = message.with_field(field)
    return message


@pytest.mark.parametrize(
    ("first", "last", "order", "positions"),
    [
        (15, 16, "big", (16, 17, 18, 19, 20, 21, 22, 23, 8, 9, 10, 11, 12, 13, 14, 15)),
        (15, 16, "little", tuple(range(8, 24))),
        (16, 15, "little", tuple(range(8, 24))),
        (11, 22, "big", (22, 23, 8, 9, 10, 11)),
        (12, 17, "little", (12, 13, 14, 15, 16, 17)),
        (5, 2, "big", (2, 3, 4, 5)),
        (7, 7, "little", (7,)),
    ],
)
def test_bits_that_the_mouse_was_drawn_over(
    first: int, last: int, order: BitOrder, positions: tuple[int, ...]
) -> None:
    """A field has the bits between the two ends, in its order."""
    start, length = dragged(first, last, order)
    assert DrawnField("x", start, length, order).positions == positions


def test_whole_bytes_stay_when_their_order_changes() -> None:
    """A field of whole bytes keeps its bytes in the other order."""
    little = DrawnField("x", 8, 24, "little")
    big = in_order(little, "big")
    assert set(big.positions) == set(little.positions)
    assert in_order(big, "little") == little
    assert in_order(DrawnField("x", 0, 0), "big").order == "big"


def test_what_is_drawn_is_a_spec_that_decodes(draft: Draft) -> None:
    """The file declares the fields as they were drawn: its protocol decodes the same values as the curve shows."""
    draft.draw(drawn(SPEED, TORQUE, FLAG))
    draft.draw(drawn(DrawnField("level", 0, 8), key=0x18FEF100 | EXTENDED, name="Engine"))
    draft.save()
    protocol = load_protocol(str(draft.path))
    rng = np.random.default_rng(3)
    frames = [Frame(0x123, rng.bytes(8), float(n), "can0") for n in range(50)]
    capture = Capture()
    capture.add_frames(FrameTable.from_frames(frames))
    records = protocol.scanner().feed(frames)
    columns = capture.rows[0].columns()
    for field in (SPEED, TORQUE, FLAG):
        values = [float(getattr(record, field.name)) for record in records]
        assert field.values(columns).tolist() == pytest.approx(values, rel=1e-12)


def test_what_is_drawn_comes_back(draft: Draft) -> None:
    """A saved file is read by another process into the same messages, and drawn on further."""
    motor = drawn(SPEED, TORQUE, FLAG)
    draft.draw(motor)
    draft.save()
    again = Draft(str(draft.path))
    with pytest.raises(CallerError, match="read it first"):
        again.draw(motor)
    assert asyncio.run(again.read()) == ""
    assert again.messages == {0x123: motor}
    assert again.closed == {}
    again.draw(motor.without("flag"))
    assert '-        "flag" / bits(1, 40),' in again.diff()


def test_what_others_wrote_stays(draft: Draft) -> None:
    """Only statements that were drawn on change: comments and other messages stay, and what says more is not drawn on."""
    draft.draw(drawn(SPEED))
    draft.save()
    mine = '\n# my own\ncar.message("Mode", id=0x200, payload=BitLayout(1, "mode" / Enumeration(bits(2), on=1)))\n'
    text = draft.path.read_text(encoding="utf-8").replace("BitLayout, P", "BitLayout, Enumeration, P") + mine
    draft.path.write_text(text, encoding="utf-8")
    assert draft.is_changed_outside
    draft.draw(drawn(SPEED, FLAG))
    with pytest.raises(CallerError, match="changed outside"):
        draft.save()
    assert asyncio.run(draft.read()) == ""
    with pytest.raises(CallerError, match="Mode says more"):
        draft.draw(drawn(FLAG, key=0x200, name="Mode"))
    draft.draw(drawn(SPEED, FLAG))
    draft.save()
    saved = draft.path.read_text(encoding="utf-8")
    assert mine in saved
    assert '"flag" / bits(1, 40)' in saved
    assert len(load_protocol(str(draft.path)).messages) == 2


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        (DrawnField("__import__('os')", 0, 8), "is not a name"),
        (DrawnField("class", 0, 8), "is not a name"),
        (DrawnField("a", 0, 65), "1 to 64"),
        (DrawnField("a", 60, 8), "beyond"),
        (DrawnField("a", 0, 9, "big"), "beyond"),
        (DrawnField("a", 0, 8, scale=0.0), "scale"),
        (DrawnField("a", 0, 8, scale=float("nan")), "scale"),
        (DrawnField("torque_2", 20, 4), "share"),
    ],
)
def test_a_field_that_cannot_be_is_refused(field: DrawnField, reason: str) -> None:
    """Names that are no names, places outside the message, and shared bits are refused with the reason."""
    with pytest.raises(CallerError, match=reason):
        drawn(TORQUE).with_field(field)


def test_a_hostile_unit_stays_text(draft: Draft) -> None:
    """A unit with quotes, line ends and code is a text in the source, and runs nothing."""
    unit = "\"\"\"\n'''); import os; raise SystemExit(3) #"
    field = DrawnField("speed", 0, 16, "little", True, 0.01, 0.0, unit)
    draft.draw(drawn(field))
    draft.save()
    message = load_protocol(str(draft.path)).messages["Motor"]
    assert [found.node.unit for found in message.plan.fields if found.name == "speed"] == [unit]


def test_a_name_that_a_record_has_itself_is_refused(draft: Draft) -> None:
    """What the spec language refuses is refused when it is drawn, not when it is saved."""
    with pytest.raises(CallerError):
        draft.draw(drawn(DrawnField("meta", 0, 8)))
    assert draft.is_saved
