"""The picture of the live screen: a recording is played onto a simulated bus, and the screen drawn without a terminal.

python docs/screen_picture.py RECORDING PROTOCOL PICTURE.svg
"""

from __future__ import annotations

import asyncio
import re
import sys
from pathlib import Path

from aces_bus import Frame, make_scanner, open_recording
from aces_bus.hardware import CanGate
from aces_tools.protocols_arg import parse_protocols
from aces_tools.screen import make_screen

#: Columns and rows of the terminal, and what is pressed before the picture is taken: sorted by rate, details of a row.
SIZE, KEYS = (150, 38), ("s", "down", "down", "d")


async def picture(frames: list[Frame], protocol: str) -> str:
    """Return the screen as SVG after these frames, at their pace."""
    bus = {"interface": "aces", "channel": "can0", "physics": False}
    player, gate = CanGate(bus, name="player"), CanGate(bus, name="can0", listen_only=True)
    app = make_screen(
        gate, make_scanner(parse_protocols([protocol]), include_unknown=True), title=protocol, colour=True
    )
    gate.start()
    player.start()
    try:
        async with app.run_test(size=SIZE) as pilot:
            last = frames[0].timestamp or 0.0
            for number, frame in enumerate(frames):
                if number == len(frames) * 3 // 4:
                    for key in KEYS:
                        await pilot.press(key)
                now = frame.timestamp or last
                if now - last > 0.01:
                    await asyncio.sleep(now - last)
                    last = now
                if not frame.is_error_frame:
                    player.send(frame)
            await app.turn()
            await pilot.pause()
            svg: str = app.export_screenshot(title=f"aces sniff can0 -p {protocol} --screen")
    finally:
        gate.stop()
        player.stop()
    return re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL)  # fonts of the network


def main() -> int:
    recording, protocol, path = sys.argv[1:]
    with open_recording(recording, link="can") as capture:
        frames = [frame for batch in capture.batches(1024) for frame in batch]
    Path(path).write_text(asyncio.run(picture(frames, protocol)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
