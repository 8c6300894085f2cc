"""Where one number ends and the next begins: which neighbouring bits belong together, and over which byte borders.

1. Two neighbouring bits are of one number when the upper one moves as the carry of what is below it; that is measured, and
   is evidence for and against. How often bits change alone decides only where carries say nothing.
2. Inside a byte bits belong together unless something speaks against it; over a border only where something speaks for it.
3. A bit has one bit above it and one below it at most, so byte orders never mix within a number.

What a number does at a border: its lower part, as a fraction of the carry, changes by Δl, its upper part by Δh, and the number
itself by s = Δh + Δl. Where s does not hang on Δl, the mean of Δh·Δl is −mean(Δl²); of two numbers that know nothing of each
other it is 0. In slow numbers the same is seen from single events: the upper part moves exactly where the lower one wraps.
READ (Marchetti and Stabili, IEEE Transactions on Information Forensics and Security 14, 2019) takes the rates of changes
alone, and big-endian order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._lazy import np
from .fields import Array, ByteOrder, Rows, above

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Bits of the lower part that are weighed.
BELOW = 8
#: What a border inside a byte may have against it, and one between bytes must have for it (log-likelihoods, in nats).
AGAINST, FOR = -3.0, 4.0
#: What one event may weigh.
EVENT = 3.0
CAP=6.0
WIDTHS=(2,4)
ENUM=0.4


def split(sample: Rows, free: Array) -> list[tuple[list[int], ByteOrder]]:
    """The bits that `free` marks, as numbers: positions, lowest first, and byte order."""
    up = _joined(sample, free)
    begins = [bit for bit in np.flatnonzero(free).tolist() if bit not in up.values()]
    found: list[tuple[list[int], ByteOrder]] = []
    for bit in begins:
        positions = [bit]
        while positions[-1] in up:
            positions.append(up[positions[-1]])
        is_big = any(b < a for a, b in zip(positions, positions[1:], strict=False))
        found.append((positions, "big" if is_big else "little"))
    return found


def _joined(sample: Rows, free: Array) -> dict[int, int]:
    """From each bit to the one above it in its number."""
    edges: dict[tuple[int, int], float] = {}
    orders: Sequence[ByteOrder] = ("little", "big")
    for order in orders:
        line = bits_in(sample.size, order)
        scores = edge_scores(sample, line, free)
        for low, high, score in zip(line[:-1].tolist(), line[1:].tolist(), scores.tolist(), strict=True):
            if free[low] and free[high] and high == above(low, order):
                edges[low, high] = max(edges.get((low, high), -np.inf), score)
    up: dict[int, int] = {}
    below: set[int] = set()
    for (low, high), score in sorted(edges.items(), key=lambda one: -one[1]):
        is_border = low // 8 != high // 8
        if score > (FOR if is_border else AGAINST) and low not in up and high not in below:
            if is_border and (up.get(_last(high // 8), -1) // 8 == low // 8):
                continue  # the two bytes are joined the other way round
            up[low] = high
            below.add(high)
    return up


def _last(byte: int) -> int:
    return 8 * byte + 7


def bits_in(size: int, order: ByteOrder) -> Array:
    """All bits of a payload in the order in which numbers go upward."""
    bits = np.arange(8 * size)
    if order == "little":
        return bits
    return (8 * (size - 1 - bits // 8)) + bits % 8


def edge_scores(sample: Rows, line: Array, free: Array) -> Array:
    """How much speaks for each two neighbours of `line` being of one number, in nats; (len(line) - 1,)."""
    bits = sample.bits[:, line].astype(np.float32) * free[line]
    low = np.zeros_like(bits)
    for column in range(bits.shape[1]):
        low[:, column] = bits[:, column] / 2
        if column:
            low[:, column] += low[:, column - 1] / 2
    before, after = sample.pairs(bits)
    step = after - before
    moves = step.any(axis=1)
    step = step[moves]
    below = sample.pairs(low)
    d_low = (below[1] - below[0])[moves, :-1]
    flips = step != 0
    upper = flips[:, 1:]
    rates = flips.mean(axis=0) if len(flips) else np.zeros(len(line))
    events = upper.sum(axis=0)
    n = max(1, len(flips))
    # The upper bit changes just where the lower part wraps, or where the lower bit changes.
    scores = np.maximum(
        _coincidence(np.abs(d_low) > 0.5, upper), _coincidence(flips[:, :-1], upper, is_mutual=False)
    )
    for width in WIDTHS:
        scores = np.maximum(scores, _covariance(d_low, _upward(step, width)))
    scores = np.clip(scores, -EVENT * events, EVENT * events)
    # In a number the upper of two bits does not change more often.
    lower_rate, upper_rate = rates[:-1], rates[1:]
    spread = np.sqrt((lower_rate * (1 - lower_rate) + upper_rate * (1 - upper_rate)) / n) + 1e-9
    excess = (upper_rate - lower_rate) / spread
    falls = (excess > 3) & (upper_rate > 1.25 * lower_rate)
    return np.where(falls, scores - np.minimum(excess, CAP), scores)


def _upward(step: Array, width: int) -> Array:
    """The change of the `width` bits above each border, the short way round; (n, columns - 1)."""
    n, columns = step.shape
    total = np.zeros((n, columns - 1), np.float32)
    for bit in range(width):
        total[:, : columns - 1 - bit] += step[:, 1 + bit :] * 2**bit
    span, half = 2.0**width, 2.0 ** (width - 1)
    wrapped = (total + half) % span - half
    return np.where(np.abs(wrapped) == half, 0, wrapped)


def _covariance(d_low: Array, d_high: Array) -> Array:
    """The likelihood of a carry against that of none, from the mean of the product of both changes."""
    product = d_low * d_high
    mean, variance = product.mean(axis=0), product.var(axis=0)
    carried = -(d_low**2).mean(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        likelihood = len(product) / (2 * variance) * (mean**2 - (mean - carried) ** 2)
    return np.where(variance > 0, likelihood, 0.0)


def _coincidence(cause: Array, effect: Array, *, is_mutual: bool = True) -> Array:
    """The likelihood of `effect` going with `cause` against that of both knowing nothing of each other."""
    n = max(1, len(cause))
    both = (cause & effect).sum(axis=0)
    causes, effects = cause.sum(axis=0), effect.sum(axis=0)
    tiny = 0.5 / n
    if is_mutual:
        rate = np.clip(effects / n, tiny, 1 - tiny)
        with_it = both * np.log(0.95 / rate) + (causes - both) * np.log(0.05 / (1 - rate))
        quiet = n - causes - effects + both
        return with_it + (effects - both) * np.log(0.02 / rate) + quiet * np.log(0.98 / (1 - rate))
    rate = np.clip(causes / n, tiny, 1 - tiny)
    # A number in large steps flips its bits at random: there a coincidence is none.
    share = 0.97 - 0.47 * np.clip((effects / n - 0.2) / 0.25, 0, 1)
    strong=both * np.log(share / rate) + (effects - both) * np.log((1 - share) / (1 - rate))
    weak=both * np.log(ENUM / rate) + (effects - both) * np.log((1 - ENUM) / (1 - rate))
    return np.where(rate<ENUM, np.maximum(strong,weak), strong)
