"""`:FMT` behind a signal: colour, marker and line style, as matplotlib and `cantools plot` write them.

1. A format is understood here, before anything is read, and means the same in a file and in the terminal.

    r--   red, dashed        C2    the third colour        .k   black points
    o-    circles on a line  |     stems, from zero to the value
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from aces_bus.errors import CallerError

_LINES = ("--", "-.", "-", ":")
_MARKERS = ".,ov^<>12348spP*hH+xXDd|_"
_COLOURS = "bgrcmykw"


@dataclass(frozen=True)
class ImageFormat:
    """What is not said is None, and left to the drawing."""

    colour: str | None = None
    marker: str | None = None
    line: str | None = None
    is_stem: bool = False


def parse_format(text: str, where: str) -> ImageFormat:
    """A format as it was typed behind the signal `where`; raises `CallerError` for what is none."""
    colour = marker = line = None
    is_stem = text.startswith("|")
    rest = text[1:] if is_stem else text
    while rest:
        style = next((style for style in _LINES if rest.startswith(style)), None)
        numbered = re.match(r"C\d", rest)
        if style is not None and line is None:
            line, rest = style, rest[len(style) :]
        elif numbered and colour is None:
            colour, rest = numbered[0], rest[2:]
        elif rest[0] in _COLOURS and colour is None:
            colour, rest = rest[0], rest[1:]
        elif rest[0] in _MARKERS and marker is None:
            marker, rest = rest[0], rest[1:]
        else:
            raise CallerError(
                f"{where!r}: {text!r} is no format; it is made of a colour (b g r c m y k w C0…C9), a line"
                " (- -- -. :) and a marker (. o s x + D …), such as r-- or .k; | in front draws stems"
            )
    return ImageFormat(colour, marker, line, is_stem)
