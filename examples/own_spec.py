"""A spec in ten lines, and what comes out of it: a scanner, an encoder, and errors that say what is wrong.

The device is a weighing scale on CAN: it sends its weight from identifier 0x180 + node, and takes a command at
0x200 + node.
"""

from __future__ import annotations

from construct import Byte, Const, Int32sl, Struct

from aces_bus import Frame, Unknown
from aces_bus.errors import FieldError
from aces_bus.protocol import CanScanner, Flags, IdField, Protocol, Quantity

scale = Protocol("scale", link="can", bitrate=500_000)
Node = IdField("node", range(1, 16))  # a part of the identifier becomes a field like any other

Weight = scale.message(
    "Weight",
    id=0x180 + Node,
    direction="from device",
    payload=Struct(
        "weight" / Quantity(Int32sl, unit="kg", scale=0.001), "state" / Flags(Byte, stable=0, overload=1)
    ),
)
Tare = scale.message("Tare", id=0x200 + Node, direction="to device", payload=Struct(Const(0xA5, Byte)))


def main() -> None:
    # Encode: fields in the sheet's units, out comes a frame; `frame_to_message` makes it a python-can message.
    frame = scale.encode("Tare", node=3)
    print(f"{frame.arbitration_id:03X}#", frame.data.hex())

    # Scan: frames in, records out; with `include_unknown`, what is not a message comes too, with the reason.
    frames = [
        Frame(0x183, bytes.fromhex("D4300000 01")),
        Frame(0x183, bytes.fromhex("D430")),
        Frame(0x700, b""),
    ]
    scanner = scale.scanner(include_unknown=True)
    assert isinstance(scanner, CanScanner)  # of a serial protocol it is a StreamScanner, and takes bytes
    for record in scanner.feed(frames):
        if isinstance(record, Unknown):
            print(record.reason, record.meta.raw.hex())
        else:
            print(record, "stable" if record.state.stable else "moving")
    print(scanner.counts)

    # What does not fit is not sent.
    try:
        scale.encode("Tare", node=16)
    except FieldError as error:
        print(error)


if __name__ == "__main__":
    main()
