"""Reads a recording of both directions and shows what one servo reported, in the sheet's units.

python examples/decode_capture.py [FILE [ID]]
"""

from __future__ import annotations

import sys
from pathlib import Path

from aces_bus import open_recording
from aces_protocols.robotis.spec import control_table, robotis

SESSION = Path(__file__).resolve().parent / "captures" / "robotis_session.dxconf.txt"


def main(file: Path = SESSION, servo: int = 2) -> None:
    # Requests and answers look alike; with both on the line, each answer is recognised by its request.
    scanner = robotis.scanner(direction="both")
    start = 0
    for chunk in open_recording(file, link="serial"):
        for record in scanner.feed(chunk.data):
            message = record.meta.message
            if message == "Read" and record.id == servo:
                start = record.start
            elif message == "Status" and record.id == servo and record.parameters:
                values = control_table.decode(start, record.parameters)
                shown = f"{values['present_position']:6.1f} °  {values['present_speed']:6.1f} rpm"
                print(f"{record.meta.offset:5}  {shown}  {', '.join(record.error)}".rstrip())
    scanner.close()
    print(scanner.counts)


if __name__ == "__main__":
    given = sys.argv[1:]
    main(Path(given[0]) if given else SESSION, int(given[1]) if len(given) > 1 else 2)
