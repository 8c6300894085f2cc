"""Small pictures for the page: a PNG of pixels, and curves of which every pixel shows all of its samples."""

from __future__ import annotations

import base64
import struct
import zlib
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[Any]


def png(pixels: Array) -> bytes:
    """Return a PNG (ISO/IEC 15948) of RGBA pixels, uint8 of shape (height, width, 4)."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        body = kind + content
        return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))

    height, width = pixels.shape[:2]
    lines = np.zeros((height, 1 + 4 * width), np.uint8)
    lines[:, 1:] = pixels.reshape(height, 4 * width)
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(lines.tobytes(), 1)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def data_url(pixels: Array) -> str:
    """Return a PNG of RGBA pixels as an address that holds it."""
    return f"data:image/png;base64,{base64.b64encode(png(pixels)).decode('ascii')}"


def thinned(x: Array, y: Array, pixels: int) -> tuple[Array, Array]:
    """Return the points of a curve that draw the same at `pixels` pixels: the least and the greatest of each, in order.

    `x` rises. NaN in `y` is a gap, and stays one.
    """
    if len(x) <= 2 * pixels:
        return x, y
    edges = np.linspace(float(x[0]), float(x[-1]), pixels + 1)
    starts = np.unique(np.searchsorted(x, edges[:-1], side="left"))
    starts = starts[starts < len(x)]
    low = np.fmin.reduceat(y, starts)
    high = np.fmax.reduceat(y, starts)
    out_x = np.repeat(x[starts], 2)
    return out_x, np.column_stack((low, high)).ravel()
