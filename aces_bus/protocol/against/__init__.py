"""A spec held against recordings: what they say that it does not, and worked examples out of them.

1. A recording is evidence, not proof: what it lacks is a note, what it contradicts again and again a warning.
2. Every observation has numbers, the first frame or packet that shows it, and a line that says what would be right.
3. Recordings are read piece by piece, and whatever is in them is data.

The rules, by the name in brackets behind an observation:

    bit-order     a layout whose numbers move smoothly only in the other order of bits
    byte-order    a number that moves smoothly only in another order of its bytes or parts
    check         a check that fails again and again; a byte that is a check, and is not declared as one
    constant      fields that never change
    content       packets whose fields cannot be read
    counter       a number that counts up and is not a Counter
    direction     messages that went the other way
    enumeration   values without a name
    gap           bits of no field that change
    range         values beyond the declared range
    sign          a number that jumps over its range where it passes zero
    size          frames and packets longer or shorter than their fields
    skipped       bytes that begin no packet
    text          texts with control characters
    undeclared    identifiers and opcodes that no message has
    unseen        messages and fields that never occur
"""

from __future__ import annotations

from .recording import check_recordings

__all__ = ["check_recordings"]
