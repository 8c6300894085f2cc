"""The exported C against the decoder: compiled, and compared on every value of each field.

1. A field's own bits take all numbers up to 16 bits, beyond them corners and drawn numbers; all other bits are 0, 1 and
   drawn.
2. What C reads is compared with the generated decoder's raw integers. Packing, floats and packets of streams are compared by
   `tests/lab/exchange/test_export_c.py`, on drawn packets.
"""

from __future__ import annotations

import random
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from aces_bus.protocol import Record, Variant
from aces_bus.protocol.generate.load import decoders_of
from aces_lab.exchange import print_c_source
from aces_lab.exchange.c_fields import CField
from aces_lab.exchange.export_c import CMessage

from .account import Outcome
from .columns import accepted_packet, field_rows, with_constants
from .decoding import Witness
from .witness import value_in_record

_MAIN = """
#include "spec.h"
#include <stdio.h>
#include <inttypes.h>
#include <string.h>
int main(int count, char **names) {
    static unsigned char data[4096], out[4096];
    int which; uint32_t id, size;
    (void)count; (void)names;
    while (fread(&which, 4, 1, stdin) == 1 && fread(&id, 4, 1, stdin) == 1 && fread(&size, 4, 1, stdin) == 1) {
        int length = -1; uint32_t made = 0;
        if (fread(data, 1, size, stdin) != size) return 1;
        memset(out, 0, sizeof out);
        (void)made; (void)length;
        switch (which) {
CASES
        }
        printf("\\n");
    }
    return 0;
}
"""


@dataclass(frozen=True)
class CJob:
    """The C export of one variant."""

    variant: Variant
    patience: float = 10.0

    def prove(self, seconds: float) -> list[Outcome]:
        """Compile it and compare it."""
        return list(check_c(self.variant))

    def lost(self, reason: str) -> list[Outcome]:
        """Return that nothing was compared."""
        found = [Outcome(self.variant.label, name) for name in self.variant.messages]
        for outcome in found:
            outcome.add("C", "unknown", reason)
        return found


def check_c(variant: Variant) -> Iterator[Outcome]:
    """Compare the C export of a variant with its decoders; yield an outcome for each message that C has, and has not."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    made = print_c_source(variant, name="spec")
    for name in variant.messages.keys() - {message.message.name for message in made.messages}:
        outcome = Outcome(variant.label, name)
        why = next((loss for loss in made.losses if name in str(loss)), None)
        outcome.add(
            "C", "unknown", "not exported" if why is None else str(why).partition(": ")[2] or str(why)
        )
        yield outcome
    if compiler is None:
        for one in made.messages:
            outcome = Outcome(variant.label, one.message.name)
            outcome.add("C", "unknown", "there is no C compiler (cc, gcc) here")
            yield outcome
        return
    with TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "spec.h").write_text(made.header, encoding="utf-8")
        (folder / "spec.c").write_text(made.source, encoding="utf-8")
        cases = "\n".join(_case(number, message) for number, message in enumerate(made.messages))
        (folder / "main.c").write_text(_MAIN.replace("CASES", cases), encoding="utf-8")
        call = [compiler, "-std=c99", "-O1", "-o", "read", "main.c", "spec.c", "-lm"]
        subprocess.run(call, cwd=folder, check=True, capture_output=True)
        for number, message in enumerate(made.messages):
            yield _compared(variant, number, message, folder)


def _case(number: int, message: CMessage) -> str:
    """Return the C statements that print a message's members, or `refused`."""
    is_can = message.message.framing is None
    lines = [
        f"        case {number}: {{ struct {message.name} s; memset(&s, 0, sizeof s);",
        f'            if ({message.name}_unpack(&s, {"id, " if is_can else ""}data, size)) {{ printf("refused"); break; }}',
    ]
    for field in message.fields:
        if field.type in ("float", "double", "bytes", "rest"):
            continue
        kind = "PRIu64, (uint64_t)" if field.type.startswith("u") else "PRId64, (int64_t)"
        lines.append(f'            printf("%" {kind}s.{field.name}); printf(" ");')
    return "\n".join([*lines, "            break; }"])


def _compared(variant: Variant, number: int, printed: CMessage, folder: Path) -> Outcome:
    message = printed.message
    outcome = Outcome(variant.label, message.name)
    base = accepted_packet(message)
    if base is None or message.plan.lists or message.plan.is_checked:
        outcome.add("C", "unknown", "no packet was drawn, a list, or a check of its own")
        return outcome
    chance = random.Random(message.name)
    packets = [base.data]
    for leaf in message.plan.leaves:
        bits = leaf.node.place
        if bits and max(bits) < 8 * len(base.data):
            rows = with_constants(message, field_rows(base, bits, chance, all_others=True), base)
            packets += [row.tobytes() for row in rows]
            if len(bits) > 16:
                outcome.add("C", "sampled", "fields of more than 16 bits: corners and drawn numbers")
    if message.framing is not None:
        outcome.add("C", "sampled", "packets of streams are compared by tests/lab/exchange/test_export_c.py")
        return outcome
    key = base.key or 0
    head = number.to_bytes(4, "little") + (key & 0x1FFF_FFFF).to_bytes(4, "little")
    sent = b"".join(head + len(data).to_bytes(4, "little") + data for data in packets)
    found = subprocess.run([folder / "read"], input=sent, capture_output=True, check=True, cwd=folder)
    decode = decoders_of(variant, True)[message.name]
    fields = [f for f in printed.fields if f.type not in ("float", "double", "bytes", "rest")]
    for data, line in zip(packets, found.stdout.decode().splitlines(), strict=True):
        record = decode(data, key, None, None, data, None)
        want = "refused" if record is None else " ".join(str(_number(record, f)) for f in fields)
        if line.strip() != want:
            outcome.witness = Witness(f"C has {line.strip()}, the decoder {want}", base.key, data)
            outcome.add("C", "refuted", "other numbers than the decoder's")
            return outcome
    outcome.add("C", "bounded", "each field's own bits, all others at 0, at 1 and drawn")
    return outcome


def _number(record: Record, field: CField) -> int:
    """Return the number that C has in a field: 0 where the record has none."""
    value = value_in_record(record, field.leaf.path)
    return value if isinstance(value, int) else 0
