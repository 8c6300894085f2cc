"""Where one number ends and the next begins: which neighbouring bits belong together, and over which byte borders.

1. Two neighbouring bits are of one number when the upper one moves as the carry of what is below it; that is measured, and
   is evidence for and against. How often bits change alone decides only where carries say nothing.
2. Inside a byte bits belong together unless something speaks against it; over a border only where something speaks for it.
3. A bit has one bit above it and one below it at most, so byte orders never mix within a number.

What a number does at a border: its lower part, as a fraction of the carry, changes by Δl, its upper part by Δh, and the
number itself by s = Δh + Δl. Where s does not hang on Δl, the mean of Δh·Δl is −mean(Δl²); of two numbers that know nothing
of each other it is 0. In slow numbers the same is seen from single events: the upper part moves where the lower one wraps.
READ (Marchetti and Stabili, IEEE Transactions on Information Forensics and Security 14, 2019) takes the rates of changes
alone, and big-endian order.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from aces_bus._lazy import np

from .fields import Array, ByteOrder, Rows, above

if TYPE_CHECKING:
    from collections.abc import Sequence

#: What a border inside a byte may have against it, and one between bytes must have for it (log-likelihoods, in nats).
AGAINST, FOR = -3.0, 4.0
#: What one event may weigh.
EVENT = 3.0
#: Pieces of a byte are one where so large a share of their changes is common.
SIMULTANEOUS = 0.8
#: Bits above a border that are weighed.
WIDTHS = (2, 4)
#: What it may weigh that the upper bit changes more often, and how often bits of an enumeration change together.
RISE, TOGETHER = 6.0, 0.4


def split(sample: Rows, free: Array) -> list[tuple[list[int], ByteOrder]]:
    """Return the bits that `free` marks, as numbers: positions, lowest first, and byte order."""
    up = _joined(sample, free)
    begins = [bit for bit in np.flatnonzero(free).tolist() if bit not in up.values()]
    found: list[tuple[list[int], ByteOrder]] = []
    for bit in begins:
        positions = [bit]
        while positions[-1] in up:
            positions.append(up[positions[-1]])
        is_big = any(b < a for a, b in pairwise(positions))
        found.append((positions, "big" if is_big else "little"))
    return found


def _joined(sample: Rows, free: Array) -> dict[int, int]:
    """Return the step from each bit to the one above it in its number."""
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
    for (low, high), score in sorted(edges.items(), key=lambda item: -item[1]):
        is_border = low // 8 != high // 8
        if score > (FOR if is_border else AGAINST) and low not in up and high not in below:
            if is_border and (up.get(_last(high // 8), -1) // 8 == low // 8):
                continue  # the two bytes are joined the other way round
            up[low] = high
            below.add(high)
    return up


def merged_pieces(
    sample: Rows, pieces: list[tuple[list[int], ByteOrder]], free: Array
) -> list[tuple[list[int], ByteOrder]]:
    """Return the pieces; those of one byte that change at the same time are one, with the constant bits between them.

    A byte that takes few values has bits that never change between others that do: it is not a row of flags.
    """
    constant = free & ~sample.varies
    found: list[tuple[list[int], ByteOrder]] = []
    by_byte: dict[int, list[list[int]]] = {}
    for bits, order in pieces:
        if bits[0] // 8 == bits[-1] // 8 and len(bits) < 8:
            by_byte.setdefault(bits[0] // 8, []).append(bits)
        else:
            found.append((bits, order))
    for byte, some in by_byte.items():
        first, *others = sorted(some)
        runs = [first]
        for bits in others:
            between = list(range(runs[-1][-1] + 1, bits[0]))
            if constant[between].all() and _are_simultaneous(sample, runs[-1], bits):
                runs[-1] = [*runs[-1], *between, *bits]
            else:
                runs.append(bits)
        whole = list(range(8 * byte, 8 * byte + 8))
        if others and len(runs) == 1 and all(constant[bit] or bit in runs[0] for bit in whole):
            runs = [whole]
        for run in runs:
            found.append((run, "little"))
    return found


def whole_bytes(free: Array) -> list[tuple[list[int], ByteOrder]]:
    """Return the bytes of which any bit is free, each by itself."""
    found: list[tuple[list[int], ByteOrder]] = []
    for byte in np.flatnonzero(free.reshape(-1, 8).any(axis=1)).tolist():
        found.append((list(range(8 * byte, 8 * byte + 8)), "little"))
    return found


def _are_simultaneous(sample: Rows, mine: list[int], other: list[int]) -> bool:
    moves = [np.not_equal(*sample.pairs(sample.values(bits))) for bits in (mine, other)]
    either = (moves[0] | moves[1]).sum()
    return bool(either >= 2 and (moves[0] & moves[1]).sum() >= SIMULTANEOUS * either)


def _last(byte: int) -> int:
    return 8 * byte + 7


def bits_in(size: int, order: ByteOrder) -> Array:
    """Return all bits of a payload in the order in which numbers go upward."""
    bits = np.arange(8 * size)
    if order == "little":
        return bits
    return (8 * (size - 1 - bits // 8)) + bits % 8


def edge_scores(sample: Rows, line: Array, free: Array) -> Array:
    """Return how much speaks for each two neighbours of `line` being of one number, in nats; (len(line) - 1,)."""
    bits = (sample.bits[:, line] * free[line]).T.astype(np.float32)
    low = np.empty_like(bits)
    below: Array = np.zeros(bits.shape[1], np.float32)
    for column, own in enumerate(bits):
        low[column] = below = (own + below) / 2
    at = np.flatnonzero(sample.follows)
    at = at[(bits[:, at + 1] != bits[:, at]).any(axis=0)]
    if not len(at):
        return np.zeros(len(line) - 1)
    step = (bits[:, at + 1] - bits[:, at]).astype(np.int8)
    d_low = low[:-1, at + 1] - low[:-1, at]
    flips = np.abs(step).astype(np.float32)
    lower, upper = flips[:-1], flips[1:]
    events = upper.sum(axis=1)
    rates = flips.mean(axis=1)
    # The upper bit changes just where the lower part wraps, or where the lower bit changes.
    scores = np.maximum(_goes_with_wraps(np.abs(d_low) > 0.5, upper), _goes_with_bit(lower, upper))
    for width in WIDTHS:
        scores = np.maximum(scores, _carries(d_low, _upward(step, width)))
    scores = np.clip(scores, -EVENT * events, EVENT * events)
    # In a number the upper of two bits does not change more often.
    lower_rate, upper_rate = rates[:-1], rates[1:]
    spread = np.sqrt((lower_rate * (1 - lower_rate) + upper_rate * (1 - upper_rate)) / len(at)) + 1e-9
    excess = (upper_rate - lower_rate) / spread
    rises = (excess > 3) & (upper_rate > 1.25 * lower_rate)
    found: Array = np.where(rises, scores - np.minimum(excess, RISE), scores)
    return found


def _upward(step: Array, width: int) -> Array:
    """Return the change of the `width` bits above each border, the short way round; int8 (columns - 1, n)."""
    total = step[1:].copy()
    for bit in range(1, width):
        total[:-bit] += step[1 + bit :] << bit
    span, half = 1 << width, 1 << width - 1
    wrapped = (total + half & span - 1) - half
    wrapped[wrapped == -half] = 0
    return wrapped


def _carries(d_low: Array, d_high: Array) -> Array:
    """Return the likelihood of a carry against that of none, from the mean of the product of both changes."""
    product = d_low * d_high
    n = product.shape[1]
    mean = product.mean(axis=1)
    variance = _dot(product, product) / n - mean**2
    carried = -_dot(d_low, d_low) / n
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        likelihood = n / (2 * variance) * (mean**2 - (mean - carried) ** 2)
    found: Array = np.where(variance > 1e-12, likelihood, 0.0)
    return found


def _goes_with_wraps(wraps: Array, effect: Array) -> Array:
    """Return the likelihood of a bit changing just where what is below it wraps, against that of no connection."""
    n = effect.shape[1]
    both, causes, effects = _dot(wraps.astype(np.float32), effect), wraps.sum(axis=1), effect.sum(axis=1)
    rate = np.clip(effects / n, 0.5 / n, 1 - 0.5 / n)
    found: Array = both * np.log(0.95 / rate) + (causes - both) * np.log(0.05 / (1 - rate))
    found += (effects - both) * np.log(0.02 / rate) + (n - causes - effects + both) * np.log(
        0.98 / (1 - rate)
    )
    return found


def _goes_with_bit(lower: Array, upper: Array) -> Array:
    """Return the likelihood of the lower of two bits changing where the upper does, against that of no connection."""
    n = upper.shape[1]
    both, effects = _dot(lower, upper), upper.sum(axis=1)
    rate = np.clip(lower.sum(axis=1) / n, 0.5 / n, 1 - 0.5 / n)

    def likelihood(share: Any) -> Array:
        found: Array = both * np.log(share / rate) + (effects - both) * np.log((1 - share) / (1 - rate))
        return found

    # A number in large steps flips its bits at random: there a coincidence is none. Bits of an enumeration often go
    # together.
    carried = likelihood(0.97 - 0.47 * np.clip((effects / n - 0.2) / 0.25, 0, 1))
    found: Array = np.where(rate < TOGETHER, np.maximum(carried, likelihood(TOGETHER)), carried)
    return found


def _dot(left: Array, other: Array) -> Array:
    """Return the sum of products, row by row."""
    found: Array = np.einsum("ij,ij->i", left, other)
    return found
