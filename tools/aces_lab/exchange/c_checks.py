"""Checks of packets in C: a function for each algorithm, and the statements that use it."""

from __future__ import annotations

from collections.abc import Sequence

from aces_bus.protocol import Check, Crc, DataIds, Extra, IdBytes, Message, RequestBytes, Sum

from .c_language import NotInC, c_hex, refuse_if


class CheckPrinter:
    """The check of a message's packets. `helpers` get the functions that it needs, whose names begin with `prefix`.

    Raises `NotInC` where C does not say it.
    """

    def __init__(self, message: Message, check: Check, prefix: str, helpers: dict[str, list[str]]) -> None:
        assert message.framing is not None
        self.check, self.framing, self.extra = check, message.framing, message.check_extra
        self.prefix, self.helpers = prefix, helpers

    def _cells(self, size: str) -> list[tuple[str, int]]:
        """Return the bytes of the check, each with the place of its lowest bit in the number."""
        check, back = self.check, self.check.size + len(self.framing.end)
        order = range(check.bytes) if check.order == "little" else range(check.bytes - 1, -1, -1)
        return [(f"data[{size} - {back - k}u]", 8 * at) for k, at in enumerate(order)]

    def test(self) -> list[str]:
        """Return statements that refuse a packet of `size` bytes whose check does not hold."""
        terms = [f"(uint32_t){cell}{f' << {at}' if at else ''}" for cell, at in self._cells("size")]
        lines = [f"    {line}" for line in self._computed("size")]
        return [f"    {line}" for line in ["{", *lines, *refuse_if(f"check != ({' | '.join(terms)})"), "}"]]

    def fill(self) -> list[str]:
        """Return statements that put the number into a packet of `length` bytes."""
        cells = [f"{cell} = (uint8_t)(check >> {at});" for cell, at in self._cells("length")]
        return [f"    {line}" for line in [*self._computed("length"), *cells]]

    def _computed(self, size: str) -> list[str]:
        """Print the declaration of `check`, the number over the covered bytes."""
        check = self.check
        if check.text is not None or check.bytes > 4:
            raise NotInC(f"a check ({check.describe}) that is text, or wider than 32 bits")
        begin, update, finish = self._engine(check)
        lines = [f"uint32_t check = {begin};"]
        back = check.size + len(self.framing.end)
        for part in check.over or (slice(len(self.framing.sync), -back),):
            covered = self.extra if isinstance(part, Extra) else part
            if isinstance(covered, (IdBytes, RequestBytes, DataIds)):
                raise NotInC("a check over an identifier, a request or data ids")
            if isinstance(covered, slice):
                low, high = _bound(covered.start or 0, size), _bound(covered.stop, size)
                lines.append(f"check = {update}(check, data + {low}, {high} - {low});")
            else:
                lines += [f"check = {update}_byte(check, {byte:#04x});" for byte in covered]
        return [*lines, f"check = {finish};"]

    def _engine(self, check: Check) -> tuple[str, str, str]:
        """Return what a check begins with, the function that goes on with it, and what it ends with."""
        mask = c_hex((1 << 8 * check.bytes) - 1)
        if isinstance(check, Crc):
            width, poly, start, refin, refout, xorout = check.parameters
            if width < 8 or width > 32 or refin != refout:
                raise NotInC(f"a check ({check.describe}) of an unusual kind")
            name = f"{self.prefix}_crc{width}_{poly:x}{'r' if refin else ''}"
            top = c_hex((1 << width) - 1)
            if refin:
                poly, start = (int(f"{n:0{width}b}"[::-1], 2) for n in (poly, start))
                step = f"check = check & 1u ? check >> 1 ^ {c_hex(poly)} : check >> 1;"
                first = "check ^= byte;"
            else:
                high = c_hex(1 << width - 1)
                step = f"check = (check & {high} ? check << 1 ^ {c_hex(poly)} : check << 1) & {top};"
                first = f"check ^= (uint32_t)byte << {width - 8};" if width > 8 else "check ^= byte;"
            inner = [first, "for (bit = 0; bit < 8; bit++) {", f"    {step}", "}", "return check;"]
            self._helper(name, inner, has_bits=True)
            return c_hex(start), name, f"(check ^ {c_hex(xorout)}) & {top}"
        name = f"{self.prefix}_{check.kind}"
        if check.kind == "sum" and isinstance(check, Sum):
            self._helper(name, ["return check + byte;"])
            finish = {"": "check", "~": "~check", "-": "0u - check"}[check.sign]
            return "0u", name, f"{finish} & {mask}"
        if check.kind == "xor":
            self._helper(name, ["return check ^ byte;"])
            return "0u", name, "check & 0xffu"
        if check.kind == "fletcher":
            self._helper(
                name,
                [
                    "const uint32_t first = (check + byte) & 0xffu;",
                    "",
                    "return first | (((check >> 8) + first) & 0xffu) << 8;",
                ],
            )
            return "0u", name, "check & 0xffffu"
        raise NotInC(f"a check ({check.describe}) of its own kind")

    def _helper(self, name: str, inner: Sequence[str], *, has_bits: bool = False) -> None:
        self.helpers[name] = [
            f"static uint32_t {name}_byte(uint32_t check, uint8_t byte)",
            "{",
            *(["    int bit;", ""] if has_bits else []),
            *(f"    {line}" if line else "" for line in inner),
            "}",
            "",
            f"static uint32_t {name}(uint32_t check, const uint8_t *data, size_t size)",
            "{",
            "    size_t at;",
            "",
            "    for (at = 0; at < size; at++) {",
            f"        check = {name}_byte(check, data[at]);",
            "    }",
            "    return check;",
            "}",
        ]


def _bound(index: int | None, size: str) -> str:
    """Return an index into a packet as C counts it."""
    if index is None:
        raise NotInC("a check over what is behind it")
    return f"({size} - {-index}u)" if index < 0 else f"{index}u"
