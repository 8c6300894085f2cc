"""The field of a recording that a measured quantity follows: where it is, its scale and offset, and how late it is.

1. All bits of a message at once: the regression of the quantity on a number is a matter of the covariances of its bits, so
   that every candidate costs a few sums, whatever the recording's length.
2. What the quantity cannot tell apart (a lowest bit that drowns in its noise) is decided by how the bits themselves move.
3. Memory and time are bounded: `ROWS` messages of each identifier, the best `CLOSELY` identifiers at `FINE_ROWS`.

The quantity is interpolated at the instants of the messages, once for each delay that is tried. For a number with the bits
b₀ … bₙ and the weights w = 1, 2, 4 … (the highest negative with a sign), covariance with the quantity is w·c and variance
w·C·w, with c and C those of the bits; the share that a line explains is (w·c)² / (w·C·w · variance of the quantity).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from aces_bus.errors import CallerError
from aces_bus.protocol.record import PlainValue

from .boundaries import FOR, bits_in, edge_scores
from .fields import Array, ByteOrder, FieldGuess, Measured, Rows, above

#: Delays that are tried (s): so late or early where nothing else is said, first and then in such steps.
LATEST, STEP = 0.6, 0.04
FINE_STEPS = np.arange(-0.04, 0.0405, 0.001)
#: The share of the time that quantity and recording have in common that a delay may be of.
OF_BOTH = 0.25
#: Messages of one identifier that are looked at, first and then; identifiers that are looked at closely.
ROWS, FINE_ROWS, CLOSELY = 1024, 16384, 6
#: Messages that a line is drawn through at least, and instants of the reference while they came.
LEAST = 20
#: Bits of a number at most; up to `ANYWHERE` it may begin at any bit, longer ones at the first of a byte.
LONGEST, ANYWHERE, SHORTEST = 32, 16, 3
#: Floats that are tried have sizes in this range.
FLOATS = 1e-12, 1e12
#: The share that a field must explain to be listed, and to be what the quantity is.
LISTED, FOUND = 0.5, 0.9
#: Guesses of a field that are given.
BEST = 6
#: Candidates are as good as the best one where they leave so much more, by share and by the number of messages.
TIES, TIES_OF_ALL = 0.01, 20
#: The share of messages that may be strangers, and how many times as far from the line they are as all others.
STRANGERS, FAR = 0.1, 4.0
#: What a bit below a number may have against it (nats, `boundaries.edge_scores`).
AGAINST = -4.5
#: A bit below it is a number's where it makes the mean square of second differences smaller than this share.
SMOOTHER = 0.9
#: The lower of two bits of a number does not change more rarely than the upper one, by this share of it.
RARELY = 0.5
#: Standard errors by which a scale and an offset may be rounded, and the share of a scale at most.
SURE, MOST_ROUNDED = 2.0, 0.003
#: The share of a field's variance that may be its noise.
MOST_NOISE = 0.2
#: A gap in the reference (s) over which nothing is interpolated, where it is also so many times its usual one.
GAP_S, GAPS = 1.0, 5.0


class MeasuredQuantity(NamedTuple):
    """A measured quantity: `values` at rising `times_s`, both float64 of shape (n,), and what it is called."""

    name: str
    unit: str
    times_s: Array
    values: Array


class Messages(NamedTuple):
    """Messages of one kind: what tells them apart, instants (s), bytes (n, size), and the kind in words."""

    key: Any
    times_s: Array
    rows: Array
    shown: str = ""


@dataclass(frozen=True)
class ReferenceGuess:
    """A field that a quantity follows: quantity(t − delay) = raw(t) × scale + offset, with `explained` of its variance.

    `scale` and `offset` are the shortest decimals within what the line leaves open; `scale_error` is the standard error.
    `residual` is the standard deviation of what is left, in the quantity's unit.
    """

    key: Any
    field: FieldGuess
    scale: float
    offset: float
    delay_s: float
    explained: float
    residual: float
    scale_error: float
    messages: int
    shown: str = ""

    @property
    def is_found(self) -> bool:
        """True if the field explains enough of the quantity to be it."""
        return self.explained >= FOUND

    def as_dict(self) -> dict[str, PlainValue]:
        """Return the guess in JSON's kinds; `message` is the kind of messages in words."""
        names = ("scale", "scale_error", "offset", "delay_s", "explained", "residual", "messages")
        bits = {name: getattr(self.field, name) for name in ("start", "length", "order", "signed")}
        return {"message": self.shown, **bits, **{name: getattr(self, name) for name in names}}


@dataclass(frozen=True)
class ReferenceGuesses:
    """A quantity, and the fields that follow it, best first; their keys are those of their messages."""

    quantity: MeasuredQuantity
    #: True if its instants are of the recording's clock; otherwise both were taken to begin together.
    is_same_clock: bool
    guesses: tuple[ReferenceGuess, ...]

    @property
    def found(self) -> ReferenceGuess | None:
        """The field that the quantity is; None where none explains enough of it."""
        return self.guesses[0] if self.guesses and self.guesses[0].is_found else None

    def fields_of(self, keys: Iterable[Any]) -> tuple[FieldGuess, ...]:
        """Return the field that was found, if it is of messages with one of these keys."""
        found = self.found
        return () if found is None or found.key not in keys else (found.field,)

    def as_dict(self) -> dict[str, PlainValue]:
        """Return it in JSON's kinds."""
        return {
            "name": self.quantity.name,
            "unit": self.quantity.unit,
            "same_clock": self.is_same_clock,
            "found": self.found is not None,
            "guesses": [guess.as_dict() for guess in self.guesses],
        }


def sought(
    messages: Iterable[Messages], times_s: Array, quantity: MeasuredQuantity, latest_s: float
) -> ReferenceGuesses:
    """Return the fields of a recording that follow a quantity; `times_s` are all instants of the recording.

    Raises `CallerError` for a recording without times.
    """
    if not len(times_s):
        raise CallerError("a reference needs a recording with times, and this one has none")
    first = float(times_s.min())
    quantity, is_same_clock = on_clock(quantity, first, float(times_s.max()))
    moved = (some._replace(times_s=some.times_s - first) for some in messages)
    both_s = min(float(quantity.times_s[-1]), float(times_s.max()) - first) - max(
        float(quantity.times_s[0]), 0.0
    )
    latest_s = min(latest_s, OF_BOTH * max(both_s, 0.0))
    return ReferenceGuesses(quantity, is_same_clock, tuple(followers(moved, quantity, latest_s)))


def on_clock(quantity: MeasuredQuantity, first_s: float, last_s: float) -> tuple[MeasuredQuantity, bool]:
    """Return a quantity on the clock of a recording (from `first_s` to `last_s`), counted from its first instant, and
    whether both had the same clock: where they have no instants in common, both are taken to begin together.
    """
    times = quantity.times_s
    common = min(times[-1], last_s) - max(times[0], first_s)
    is_same = bool(common >= min(times[-1] - times[0], last_s - first_s) / 2)
    return quantity._replace(times_s=times - (first_s if is_same else times[0])), is_same


def followers(
    messages: Iterable[Messages], quantity: MeasuredQuantity, latest_s: float = LATEST
) -> list[ReferenceGuess]:
    """Return the fields that explain a quantity, best first, the best of each kind of messages; none explains less than
    `LISTED`. Delays of up to `latest_s` are tried, either way.
    """
    coarse = sorted(
        ((_coarse(some, quantity, latest_s), number, some) for number, some in enumerate(messages)),
        key=lambda entry: (-entry[0].explained, entry[1]),
    )
    found = [
        _closely(some, quantity, best) for best, _, some in coarse[:CLOSELY] if best.explained >= LISTED / 2
    ]
    return sorted(
        (guess for guess in found if guess is not None and guess.explained >= LISTED),
        key=lambda guess: -guess.explained,
    )[:BEST]


# ---------------------------------------------------------------------- delays


class _Coarse(NamedTuple):
    explained: float
    delay_s: float


def _delayed(quantity: MeasuredQuantity, times: Array, delays: Array) -> tuple[Array, Array]:
    """Return which messages came while there was a reference at all delays, and its values for them (n, delays)."""
    known = quantity.times_s
    gaps = np.diff(known)
    usual = float(np.median(gaps))
    is_gap = gaps > max(GAP_S, GAPS * usual)
    earliest, latest = times - delays.max(), times - delays.min()
    used = (earliest >= known[0]) & (latest <= known[-1])
    if is_gap.any():
        # Gaps that begin before the latest instant, less those that end before the earliest one.
        begun = np.searchsorted(known[:-1][is_gap], latest, "left")
        over = np.searchsorted(known[1:][is_gap], earliest, "right")
        used &= begun == over
    at = times[used]
    values = np.stack([np.interp(at - delay, known, quantity.values) for delay in delays], axis=1)
    return used, values


def _thinned(messages: Messages, most: int) -> tuple[Array, Array]:
    """Return times and rows, `most` of them at most, evenly from first to last."""
    count = len(messages.times_s)
    if count <= most:
        return messages.times_s, messages.rows
    places = np.linspace(0, count - 1, most).astype(np.int64)
    return messages.times_s[places], messages.rows[places]


def _coarse(messages: Messages, quantity: MeasuredQuantity, latest_s: float) -> _Coarse:
    """Return how much of a quantity the best field explains, and at which delay, in large steps."""
    times, rows = _thinned(messages, ROWS)
    delays = STEP * np.arange(-np.ceil(latest_s / STEP), np.ceil(latest_s / STEP) + 1)
    used, values = _delayed(quantity, times, delays)
    if used.sum() < LEAST:
        return _Coarse(0.0, 0.0)
    best = _Coarse(0.0, 0.0)
    for candidates in _candidates(rows[used], values):
        if candidates.explained.size:
            at = np.unravel_index(int(np.argmax(candidates.explained)), candidates.explained.shape)
            best = max(best, _Coarse(float(candidates.explained[at]), float(delays[at[1]])))
    for _, explained in _floats(rows[used], values):
        best = max(best, _Coarse(float(explained.max()), float(delays[np.argmax(explained)])))
    return best


# ---------------------------------------------------------------------- candidates


class _Candidates(NamedTuple):
    """Numbers of one byte order, with or without a sign, and the share that they explain at each delay.

    `line` has the bits of the payload in the order in which numbers go upward; number `i` has those from `starts[i]` to
    `ends[i]` (both are part of it). `explained` is of shape (numbers, delays).
    """

    order: ByteOrder
    signed: bool
    line: Array
    starts: Array
    ends: Array
    explained: Array

    def positions(self, number: int) -> tuple[int, ...]:
        return tuple(self.line[self.starts[number] : self.ends[number] + 1].tolist())


def _candidates(rows: Array, values: Array) -> Iterator[_Candidates]:
    """Yield the numbers of all byte orders and signs, with the share of each column of `values` that they explain."""
    size = rows.shape[1]
    bits = np.unpackbits(rows, axis=1, bitorder="little").astype(np.float64)
    bits -= bits.mean(axis=0)
    values = values - values.mean(axis=0)
    among = bits.T @ bits / len(bits)
    with_values = bits.T @ values / len(bits)
    spread = np.maximum((values**2).mean(axis=0), 1e-300)
    varies = np.diag(among) > 0
    steps = np.arange(LONGEST)
    weights = 2.0**steps
    orders: tuple[ByteOrder, ...] = ("little", "big")
    for order in orders:
        line = bits_in(size, order)
        starts = np.flatnonzero(varies[line])
        at = starts[:, None] + steps
        inside = at < 8 * size
        place = line[np.minimum(at, 8 * size - 1)]
        usable = inside & varies[place] & (steps >= SHORTEST - 1)
        usable &= (steps < ANYWHERE) | (place[:, :1] % 8 == 0)
        if order == "big":
            usable &= place // 8 != place[:, :1] // 8
        terms = among[place[:, :, None], place[:, None, :]] * (weights[:, None] * weights)
        below = np.cumsum(terms, axis=1)
        variance = np.diagonal(np.cumsum(below, axis=2), axis1=1, axis2=2)[usable]
        highest = np.diagonal(terms, axis1=1, axis2=2)[usable]
        # What the highest bit has in common with those below it: with a sign, its weight is negative.
        carried = np.diagonal(below, axis1=1, axis2=2)[usable] - highest
        own = with_values[place] * weights[:, None]
        covariance, last = np.cumsum(own, axis=1)[usable], own[usable]
        row, column = np.nonzero(usable)
        for signed in (False, True):
            together = covariance - 2 * last if signed else covariance
            alone = variance - 4 * carried if signed else variance
            good = alone > 1e-9 * highest
            share = together[good] ** 2 / (alone[good, None] * spread)
            yield _Candidates(order, signed, line, starts[row[good]], (starts[row] + column)[good], share)


def _floats(rows: Array, values: Array) -> Iterator[tuple[FieldGuess, Array]]:
    """Yield the numbers of IEEE 754 with 32 bits that change, with the share of each column that they explain."""
    orders: tuple[ByteOrder, ...] = ("little", "big")
    for byte in range(rows.shape[1] - 3):
        for order in orders:
            start = 8 * (byte if order == "little" else byte + 3)
            field = FieldGuess(start, 32, order, "float", 0.0, "", signed=True)
            raw = raw_values(field, rows)
            size = np.abs(raw[raw != 0])
            if len(size) and np.isfinite(raw).all() and FLOATS[0] <= size.min() <= size.max() <= FLOATS[1]:
                yield field, _correlated(raw, values)


# ---------------------------------------------------------------------- the best fields, closely


def _closely(messages: Messages, quantity: MeasuredQuantity, coarse: _Coarse) -> ReferenceGuess | None:
    """Return the best field of a kind of messages, with its scale, offset and delay."""
    times, rows = _thinned(messages, FINE_ROWS)
    delay = coarse.delay_s
    rough = _field_at(messages, times, rows, quantity, delay)
    if rough is None:
        return None
    field, used, values = rough
    keeps = _without_strangers(raw_values(field, rows[used]), values)
    times, rows = times[used][keeps], rows[used][keeps]
    delays = delay + FINE_STEPS
    used, columns = _delayed(quantity, times, delays)
    if used.sum() >= LEAST:
        delay = float(delays[np.argmax(_correlated(raw_values(field, rows[used]), columns))])
    fine = _field_at(messages, times, rows, quantity, delay)
    if fine is None:
        return None
    field, used, values = fine
    return _fitted(messages, field, rows[used], values, delay, quantity, int((~keeps).sum()))


def _field_at(
    messages: Messages, times: Array, rows: Array, quantity: MeasuredQuantity, delay: float
) -> tuple[FieldGuess, Array, Array] | None:
    """Return the best field at a delay, which messages were used for it, and the values of the quantity for these."""
    used, values = _delayed(quantity, times, np.array([delay]))
    field = _picked(messages.rows, rows[used], values) if used.sum() >= LEAST else None
    return None if field is None else (field, used, values[:, 0])


def _without_strangers(raw: Array, values: Array) -> Array:
    """Return the mask without the few messages that are far from the line: other contents under the same identifier."""
    slope, offset = np.polyfit(raw, values, 1)
    far = np.abs(values - slope * raw - offset)
    keeps: Array = far <= FAR * np.quantile(far, 1 - STRANGERS) + 1e-12
    return keeps


def _correlated(raw: Array, values: Array) -> Array:
    """Return the share of each column that a line through `raw` explains."""
    raw, values = raw - raw.mean(), values - values.mean(axis=0)
    found: Array = (raw @ values) ** 2 / np.maximum((values**2).sum(axis=0) * (raw @ raw), 1e-300)
    return found


def _picked(all_rows: Array, rows: Array, values: Array) -> FieldGuess | None:
    """Return the number that explains a quantity as well as the best one does: the shortest of these, with the bits below
    it that move as its own, and above it those that repeat its sign.
    """
    some, floats = list(_candidates(rows, values)), list(_floats(rows, values))
    best = max(
        (float(candidates.explained.max()) for candidates in some if candidates.explained.size), default=0.0
    )
    share, number = max(((float(e[0]), n) for n, (_, e) in enumerate(floats)), default=(0.0, 0))
    if max(best, share) <= 0:
        return None
    if share >= best:
        return floats[number][0]
    tolerated = (1 - best) * (1 + max(TIES, TIES_OF_ALL / len(rows))) + 1e-9
    ties: set[tuple[ByteOrder, bool, tuple[int, ...]]] = {
        (candidates.order, candidates.signed, candidates.positions(number))
        for candidates in some
        for number in np.flatnonzero(1 - candidates.explained[:, 0] <= tolerated).tolist()
    }
    order, signed, positions = min(ties, key=lambda tie: (len(tie[2]), tie))
    sample = Rows(all_rows)
    orders: tuple[ByteOrder, ...] = ("little", "big") if positions[0] // 8 == positions[-1] // 8 else (order,)
    fields = [
        _grown(sample, rows, _downward(sample, positions, way, signed, ties), way, signed) for way in orders
    ]
    return max(fields, key=lambda field: field.length)


def _downward(
    sample: Rows, positions: tuple[int, ...], order: ByteOrder, signed: bool, ties: Container[Any]
) -> tuple[int, ...]:
    """Return a number with the bits below it that do no harm, as long as they move like its own."""
    line = bits_in(sample.size, order)
    scores = edge_scores(sample, line, sample.varies)
    at = int(np.flatnonzero(line == positions[0])[0])
    # Where a number is in one byte, its order is open: over the byte's border something must speak for it.
    least = FOR if positions[0] // 8 == positions[-1] // 8 else AGAINST
    while at and sample.varies[line[at - 1]]:
        low, high = int(line[at - 1]), int(line[at])
        longer = (low, *positions)
        goes_along = scores[at - 1] > (least if low // 8 != high // 8 else AGAINST)
        goes_along &= sample.rates[low] >= RARELY * sample.rates[high]
        # Of a slow number each further bit makes the curve smoother; a foreign one makes it rougher.
        before, after = (_bends(sample, bits, order, signed) for bits in (positions, longer))
        if not goes_along and after / 4 > SMOOTHER * before:
            break
        if not any((way, signed, longer) in ties for way in ("little", "big")):
            break
        positions = longer
        at -= 1
    return positions


def _grown(
    sample: Rows, rows: Array, positions: tuple[int, ...], order: ByteOrder, signed: bool
) -> FieldGuess:
    """Return a number with the bits above it that repeat its sign, or one that is its opposite: then it has no sign. Without
    a sign it has the zeros above it that fill its byte.
    """
    bits = np.unpackbits(rows, axis=1, bitorder="little")
    while signed and 0 <= (nxt := above(positions[-1], order)) < 8 * sample.size:
        is_same = bits[:, nxt] == bits[:, positions[-1]]
        if not is_same.all() and is_same.any():
            break
        positions = (*positions, nxt)
        signed = bool(is_same.all())
    while not signed and (top := positions[-1]) % 8 != 7 and not (sample.varies[top + 1] or bits[0, top + 1]):
        positions = (*positions, top + 1)
    return FieldGuess(positions[0], len(positions), order, "number", 0.0, "", signed)


def raw_values(field: FieldGuess, rows: Array) -> Array:
    """Return the numbers of a field, float64."""
    if field.kind == "float":
        first = field.first_byte
        words = np.ascontiguousarray(rows[:, first : first + 4])
        with np.errstate(invalid="ignore"):  # signalling NaN
            return words.view("<f4" if field.order == "little" else ">f4")[:, 0].astype(np.float64)
    bits = np.unpackbits(rows, axis=1, bitorder="little")
    weights = 2.0 ** np.arange(field.length)
    if field.signed:
        weights[-1] = -weights[-1]
    return np.asarray(bits[:, list(field.positions)] @ weights)


def _fitted(
    messages: Messages,
    field: FieldGuess,
    rows: Array,
    values: Array,
    delay: float,
    quantity: MeasuredQuantity,
    strangers: int,
) -> ReferenceGuess:
    raw = raw_values(field, rows)
    middle, mean = float(raw.mean()), float(values.mean())
    spread = float(((raw - middle) ** 2).sum())
    exact = float(((raw - middle) * (values - mean)).sum() / spread)
    left = values - mean - exact * (raw - middle)
    residual = float(np.sqrt((left**2).sum() / max(1, len(rows) - 2)))
    error = residual / spread**0.5
    # Noise of the field itself makes the line flatter than it is, by its share of the field's variance.
    noise = min(_noise(field, messages.rows), (residual / exact) ** 2) * len(rows)
    exact /= 1 - min(noise / spread, MOST_NOISE)
    scale = rounded_within(exact, min(SURE * error, MOST_ROUNDED * abs(exact)))
    offset_error = SURE * (residual / len(rows) ** 0.5 + error * abs(middle))
    explained = float(1 - (left**2).mean() / max(float(values.var()), 1e-300))
    confidence = max(0.0, min(0.99, explained))
    said = f"{quantity.name}: explains {explained:.2%}, leaves {residual:.3g}{quantity.unit and ' ' + quantity.unit}"
    said += f", {1e3 * delay:+.0f} ms late, scale {exact:.6g} ± {error:.1g} by {len(rows):,} messages"
    if strangers:
        said += f", without {strangers:,} that are far from it"
    measured = Measured(
        quantity.name, quantity.unit, scale, rounded_within(mean - scale * middle, offset_error)
    )
    field = replace(
        field,
        kind="float" if field.kind == "float" else "quantity",
        confidence=confidence,
        evidence=said,
        measured=measured,
    )
    return ReferenceGuess(
        messages.key,
        field,
        scale,
        measured.offset,
        delay,
        explained,
        residual,
        error,
        len(rows),
        messages.shown,
    )


def _noise(field: FieldGuess, rows: Array) -> float:
    """Return the variance of what changes from message to message in a number that moves slowly."""
    return _bends_of(Rows(rows), field) / 6


def _bends(sample: Rows, positions: tuple[int, ...], order: ByteOrder, signed: bool) -> float:
    return _bends_of(sample, FieldGuess(positions[0], len(positions), order, "number", 0.0, "", signed))


def _bends_of(sample: Rows, field: FieldGuess) -> float:
    """Return the mean square of the second differences of a number."""
    raw = raw_values(field, sample.bytes)
    bends = (raw[2:] - 2 * raw[1:-1] + raw[:-2])[sample.follows[1:] & sample.follows[:-1]]
    return float((bends**2).mean()) if len(bends) else 0.0


def rounded_within(value: float, error: float) -> float:
    """Return the number with the fewest digits that is at most `error` away.

    >>> rounded_within(0.0099871, 0.00002), rounded_within(-40.02, 0.1), rounded_within(0.3, 0.5)
    (0.01, -40.0, 0.0)
    """
    if abs(value) <= error:
        return 0.0
    return next(
        (near for digits in range(1, 12) if abs((near := float(f"{value:.{digits}g}")) - value) <= error),
        value,
    )
