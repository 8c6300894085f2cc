"""candump's frame filters: `can0,060:7F0,150~7FF,#FFFFFFFF,j`.

1. The rules are SocketCAN's, bit for bit, on the 32-bit identifier: EFF 0x80000000, RTR 0x40000000, 29 bits.
2. An identifier of eight digits has EFF set; the mask alone says whether that is compared (12345678:DFFFFFFF).

    id:mask   passes when received & mask == id & mask    123:7FF       also extended and remote frames with these bits
    id~mask   passes when they differ                     123:C00007FF  only the standard data frame 123
    #mask     passes error frames of these classes        #FFFFFFFF     all of them
    j         all filters must pass, instead of any
    can0      in front: only this interface (`any`: all)

*Facts*: Linux Documentation/networking/can.rst §4.1.1 and net/can/af_can.c; candump's help text. As there, error frames
pass no id filter, only `#mask`; a `#mask` without id filters lets all data frames pass.
*Choice*: an interface alone lets its error frames pass. candump never records these unless asked, so a log that has
them wants them. `0x` in front of an identifier is not counted as two of its digits.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeAlias

import msgspec

from .._lazy import np
from ..errors import CallerError
from ..frame_table import FrameFlag, FrameTable

if TYPE_CHECKING:
    import numpy.typing as npt

Mask: TypeAlias = "npt.NDArray[np.bool_]"

EFF, RTR, ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_SFF_MASK = 0x7FF

_RULE = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{1,8})([:~])(?:0[xX])?([0-9A-Fa-f]{1,8})")
_ERRORS = re.compile(r"#(?:0[xX])?([0-9A-Fa-f]{1,8})")
_HEX = re.compile(r"(?:0[xX])?[0-9A-Fa-f]+")
_HELP = (
    "write id:mask (060:7F0), id~mask (150~7FF, all others), #errormask (#FFFFFFFF) or j (all must pass), "
    "joined by commas, an interface in front if wanted: can0,060:7F0"
)


class FilteredFrame(Protocol):
    """What a filter looks at: a `Frame` or a python-can `Message`."""

    @property
    def arbitration_id(self) -> int: ...
    @property
    def is_extended_id(self) -> bool: ...
    @property
    def is_remote_frame(self) -> bool: ...
    @property
    def is_error_frame(self) -> bool: ...
    @property
    def channel(self) -> object: ...


class _Rule(NamedTuple):
    wanted: int  # already masked
    mask: int
    inverted: bool


class _Set(msgspec.Struct, frozen=True):
    """The filters of one interface."""

    interface: str | None
    rules: tuple[_Rule, ...]
    error_mask: int | None
    join: bool

    def matches(self, frame: FilteredFrame) -> bool:
        if self.interface is not None and str(frame.channel) != self.interface:
            return False
        if frame.is_error_frame:
            if self.error_mask is None:
                return not self.rules
            return bool((frame.arbitration_id | ERR) & self.error_mask)
        if not self.rules:
            return True
        word = frame.arbitration_id
        if frame.is_extended_id:
            word |= EFF
        if frame.is_remote_frame:
            word |= RTR
        for wanted, mask, inverted in self.rules:
            if (word & mask == wanted) is inverted:
                if self.join:
                    return False
            elif not self.join:
                return True
        return self.join


class CanFilter(msgspec.Struct, frozen=True):
    """What passes: a frame that one of the sets lets pass. Made by `parse_filter`."""

    texts: tuple[str, ...]
    sets: tuple[_Set, ...]

    def matches(self, frame: FilteredFrame) -> bool:
        """Return whether the frame passes."""
        return any(interface_filter.matches(frame) for interface_filter in self.sets)


def parse_filter(*texts: str) -> CanFilter:
    """Parse filters as candump takes them, one text an interface; a frame passes if any of the texts lets it
    pass. A first part without a mask in front of others is an interface, also where it is a number
    (`0,060:7F0`), as formats with numbers have it.

    Raises `CallerError`, with what can be written, on anything else.

    >>> from aces_bus import Frame
    >>> boards = parse_filter("060:7F0")
    >>> [boards.matches(Frame(id)) for id in (0x05F, 0x060, 0x06F, 0x070)]
    [False, True, True, False]
    """
    if not texts:
        raise CallerError(f"no filter given; {_HELP}")
    return CanFilter(texts, tuple(_parse(text) for text in texts))


def _parse(text: str) -> _Set:
    interface: str | None = None
    rules: list[_Rule] = []
    error_mask: int | None = None
    join = False
    for place, token in enumerate(part.strip() for part in text.split(",")):
        if found := _RULE.fullmatch(token):
            rules.append(_rule(*found.groups()))
        elif found := _ERRORS.fullmatch(token):
            error_mask = int(found[1], 16)
        elif token in ("j", "J"):
            join = True
        elif _HEX.fullmatch(token) and (place > 0 or "," not in text):
            exact = f"{token}:{'DFFFFFFF' if len(token) == 8 else '7FF'}"
            raise CallerError(f"filter {text!r}: {token!r} has no mask; for this identifier alone: {exact}")
        elif place == 0 and token and not re.search(r"[:~#\s]", token):
            interface = None if token == "any" else token
        else:
            raise CallerError(f"filter {text!r}: {token!r} is not a filter; {_HELP}")
    return _Set(interface, tuple(rules), error_mask, join)


def _rule(digits: str, sign: str, mask_digits: str) -> _Rule:
    wanted, mask = int(digits, 16), int(mask_digits, 16) & ~ERR
    if len(digits) == 8:
        wanted |= EFF
    if mask & EFF and not wanted & EFF:  # only standard frames: the kernel clears bits that they do not have
        mask &= _SFF_MASK | EFF | RTR
    return _Rule(wanted & mask, mask, sign == "~")


def passing(wanted: CanFilter, table: FrameTable) -> Mask:
    """Return which of the frames of a table pass, as a boolean array: those for which `CanFilter.matches` is true.

    >>> from aces_bus import Frame
    >>> from aces_bus.recordings.filters import parse_filter
    >>> frames = FrameTable.from_frames([Frame(id) for id in (0x05F, 0x060, 0x06F, 0x070)])
    >>> passing(parse_filter("060:7F0"), frames).tolist()
    [False, True, True, False]
    """
    is_error = table.flags & FrameFlag.ERROR != 0
    word = table.id.astype(np.uint32)
    word |= (table.flags & FrameFlag.EXTENDED != 0) * np.uint32(EFF)
    word |= (table.flags & FrameFlag.REMOTE != 0) * np.uint32(RTR)
    passed = np.zeros(len(table), np.bool_)
    for interface_filter in wanted.sets:
        data = np.full(len(table), not interface_filter.rules or interface_filter.join)
        for rule_id, mask, inverted in interface_filter.rules:
            hit = (word & np.uint32(mask) == np.uint32(rule_id)) != inverted
            data = data & hit if interface_filter.join else data | hit
        if interface_filter.error_mask is None:
            errors = np.full(len(table), not interface_filter.rules)
        else:
            errors = (table.id | np.uint32(ERR)) & np.uint32(interface_filter.error_mask) != 0
        found = np.where(is_error, errors, data)
        if interface_filter.interface is not None:
            is_there = np.array(
                [str(name) == interface_filter.interface for name in table.channels.names], np.bool_
            )
            found &= is_there[table.channel]
        passed |= found
    return passed
