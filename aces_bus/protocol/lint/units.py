"""Whether a text is a unit: SI with its prefixes, and what data sheets write beside it.

1. A unit is factors joined by `·`, `*`, `.` or a blank and divided by `/`, each with an optional whole exponent
   (`m/s²`, `m/s^2`, `kg·m2`, `rad s-1`), perhaps behind a number (`2 µs`).
2. The table is data. What a sheet writes and SI does not know stands in it as it is (`count`, `turn`, `%`, `rpm`).

>>> [is_unit(text) for text in ("N·m", "0.1 mA", "rad/s²", "count", "degC", "bogus", "mm/", "kcount")]
[True, True, True, True, True, False, False, False]
"""

from __future__ import annotations

import difflib
import re


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: Units that take prefixes: the base and derived units of SI (BIPM brochure, 9th edition), and some beside it.
PREFIXED = _words(
    "m g s A K mol cd rad sr Hz N Pa J W C V F Ω ohm Ohm S Wb T H lm lx Bq Gy Sv kat L l t eV Wh Ah VA var bar "
    "gauss Gs G B bit bps baud Bd sps Sps cal gal dB"
)
PREFIXES = _words("Y Z E P T G M k h da d c m µ μ u n p f a z y Ki Mi Gi")
#: Units that do not: angles, times and counts of data sheets, imperial ones, and names of SI written out.
PLAIN = _words(
    "% ‰ ppm ppb ° deg ° ' ″ ′ °C °F degC degF Celsius °/s deg/s min h d yr rpm RPM rev turn turns r count counts "
    "cnt ct LSB lsb digit digits tick ticks step steps pulse pulses px pixel pixels sample samples ratio pu "
    "in ft yd mi mph kph knot knots kn kt kts psi lb lbf lbs oz ozf ft·lb gf kgf rps cps fps dBm dBi dBV pH RH %RH "
    "Nm mNm kNm Ncm atm mmHg inHg Torr torr mgauss ha byte bytes bits word words bool flag "
    "degree degrees radian radians meter metre meters metres second seconds ampere volt watt newton kelvin hertz"
)
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?\s*(?:[·*×]\s*)?")
_FACTOR = re.compile(r"(?P<name>.*?[^\d^+\-⁰¹²³⁴⁵⁶⁷⁸⁹⁻])(?P<power>\^?[+-]?\d+|[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+)?$")


def is_unit(text: str) -> bool:
    """Whether `text` is a unit; an empty one is (a number without unit)."""
    text = text.strip()
    if not text or text in PLAIN:
        return True
    number = _NUMBER.match(text)
    rest = text[number.end() :] if number is not None else text
    if not rest:
        return text == "1"
    if rest.startswith("/"):
        rest = "1" + rest
    if rest in PLAIN:
        return True
    bare = rest.replace("(", "").replace(")", "")
    if rest.count("(") != rest.count(")"):
        return False
    return all(
        all(_is_factor(factor) for factor in re.split(r"[·⋅*.\s]+", part.strip())) for part in bare.split("/")
    )


def _is_factor(text: str) -> bool:
    if text == "1" or text in PLAIN:
        return True
    found = _FACTOR.match(text)
    name = found["name"] if found is not None else text
    if name in PLAIN or name in PREFIXED:
        return True
    return any(name[:size] in PREFIXES and name[size:] in PREFIXED for size in (1, 2))


def suggest(text: str) -> str | None:
    """A unit that was perhaps meant."""
    folded = {name.lower(): name for name in sorted(PREFIXED | PLAIN)}
    near = difflib.get_close_matches(text.strip().lower(), folded, n=1, cutoff=0.6)
    return folded[near[0]] if near else None


__all__ = ["is_unit", "suggest"]
