"""When a log goes on in its next file, and what that is called."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass

from aces_bus.errors import CallerError
from aces_bus.recordings.write import split_suffix

from .options import duration

_SIZE = re.compile(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([kKMG])(i?)B?")
_POWERS = {"k": 1, "K": 1, "M": 2, "G": 3}


@dataclass(frozen=True)
class Rotation:
    """When the next file begins: after so many bytes, or so long after the first item (ns). None: never."""

    size: int | None = None
    ns: int | None = None

    @classmethod
    def parse(cls, texts: Sequence[str]) -> Rotation:
        """Parse what --rotate is given: sizes and durations.

        Raises `CallerError` for what is neither.

        >>> Rotation.parse(["100MB", "10min"])
        Rotation(size=100000000, ns=600000000000)
        >>> Rotation.parse(["2MiB"]).size
        2097152
        """
        sizes: list[int] = []
        times: list[int] = []
        for text in texts:
            if found := _SIZE.fullmatch(text.strip()):
                sizes.append(
                    max(1, round(float(found[1]) * (1024 if found[3] else 1000) ** _POWERS[found[2]]))
                )
                continue
            try:
                if text.strip()[-1:].isdigit():
                    raise argparse.ArgumentTypeError  # of what?
                times.append(duration(text))
            except argparse.ArgumentTypeError:
                raise CallerError(
                    f"--rotate {text}: write a size, such as 100MB, or a duration, such as 10min"
                ) from None
        return cls(min(sizes, default=None), min(times, default=None))

    def __bool__(self) -> bool:
        return self.size is not None or self.ns is not None


def numbered(path: str, number: int | str) -> str:
    """Return the name of a file of a series.

    >>> numbered("logs/walk.asc.gz", 3)
    'logs/walk-00003.asc.gz'
    """
    mark = number if isinstance(number, str) else f"{number:05}"
    stem, suffix, packing = split_suffix(path)
    return f"{stem}-{mark}{suffix}{packing}"
