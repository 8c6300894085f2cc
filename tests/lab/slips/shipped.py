"""Slips in shipped specs, held against recordings of twins: `python -m tests.lab.slips.shipped [PROTOCOL …]`

1. A slip is one change of a spec's source (`tests/protocol/mutations.py`); the same ones are drawn each time, all kinds of
   each protocol in turn. What a slip only means otherwise (scales, names of values) counts, too.
2. `aces spec check --against` is asked as an author asks it, without the laws. A slip is told when the check ends with
   status 1, and says an error or a warning that it does not say of the spec as shipped.
3. Recordings are virtual: the driver's example robot moves for some seconds.
"""

from __future__ import annotations

import ast
import io
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from aces_tools.main import main as aces
from tests.bench.twin_traffic import twin_traffic
from tests.protocol.mutations import Mutation, drawn, folder_of

#: Driver whose twin is recorded, by protocol.
DRIVERS = {
    "damiao": "damiao",
    "dynamixel": "dynamixel",
    "feetech": "feetech",
    "lx16a": "lx16a",
    "moteus": "moteus",
    "odrive": "odrive",
    "rmdx": "rmdx",
    "robstride": "robstride",
    "vesc": "vesc",
}
EACH, SEED = 10, 2026

#: Why no byte of these recordings betrays a slip that the check does not tell, by its kind.
UNBETRAYED = {
    "missing direction": "a message without a direction reads the same bytes: a recording does not hold who sent",
    "sign": "the number's highest bit is never set in the recording, or the message is not in it",
    "scale": "a register's number has no range and no example: only its meaning changes",
    "enumeration value": "the recording does not hold the value, or only its name changes",
}
#: What bytes can betray and the check does not tell: values of registers are not held against one another.
UNTOLD = {
    "feetech: byte order": "two-byte registers of the SCS series, whose byte order the other registers have, too"
}


def recorded(driver: str, folder: Path) -> Path:
    """The traffic of a driver's twin as a file: candump, or bytes of both directions."""
    _, _, heard = next(iter(twin_traffic(driver)))
    if heard and isinstance(heard[0], tuple):
        path = folder / f"{driver}.bin"
        path.write_bytes(b"".join(data for data, _ in heard))
        return path
    path = folder / f"{driver}.log"
    lines = [
        f"({1000 + (frame.timestamp or 0.0):.6f}) can0"
        f" {frame.arbitration_id:0{8 if frame.is_extended_id else 3}X}#{frame.data.hex().upper()}\n"
        if not frame.is_fd
        else f"({1000 + (frame.timestamp or 0.0):.6f}) can0"
        f" {frame.arbitration_id:0{8 if frame.is_extended_id else 3}X}##1{frame.data.hex().upper()}\n"
        for frame in heard
    ]
    path.write_text("".join(lines), encoding="utf-8")
    return path


def checked(protocol: str, mutation: Mutation | None, recording: Path, folder: Path) -> tuple[int, set[str]]:
    """Status of the check of a spec, changed or as shipped, and its errors and warnings without their places."""
    package = folder / (
        f"{protocol}_{mutation.module[:-3]}_{mutation.number}" if mutation else f"{protocol}_sound"
    )
    shutil.copytree(folder_of(protocol), package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in package.glob("*.py"):  # as a changed module is: without comments
        path.write_text(ast.unparse(ast.parse(path.read_text(encoding="utf-8"))), encoding="utf-8")
    if mutation is not None:
        (package / mutation.module).write_text(mutation.text, encoding="utf-8")
    wrapper = folder / f"{package.name}_wrapper.py"
    wrapper.write_text(f"from {package.name}.spec import {protocol}\n", encoding="utf-8")
    call = ["spec", "check", str(wrapper), "--for", "0", "--against", str(recording)]
    if recording.suffix == ".bin":
        call += ["--direction", "both"]
    out, said = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(said):
        status = aces(call)
    text = out.getvalue() + said.getvalue()
    found = {m[1] for line in text.splitlines() if (m := re.search(r"(?:error|warning|Error): (.*)", line))}
    return status, found


def main(words: Sequence[str]) -> int:
    told, total = Counter[str](), Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sys.path.insert(0, name)
        for protocol, driver in DRIVERS.items():
            if words and protocol not in words:
                continue
            recording = recorded(driver, folder)
            _, before = checked(protocol, None, recording, folder)
            for mutation in drawn([protocol], EACH, SEED, in_turn=True):
                status, said = checked(protocol, mutation, recording, folder)
                new = said - before
                is_told = status == 2 or bool(status and new)
                total[mutation.kind] += 1
                told[mutation.kind] += is_told
                why = min(new, default="") if status != 2 else "its import fails"
                print(f"{'told  ' if is_told else 'silent'}  {mutation}  {why[:90]}", flush=True)
    print()
    for kind in sorted(total):
        print(f"{kind:20} {told[kind]:3} of {total[kind]:3}")
    print(f"of all: {sum(told.values())} of {sum(total.values())}")
    silent = {kind: total[kind] - told[kind] for kind in total}
    for kind, why in UNBETRAYED.items():
        print(f"not betrayed: {silent.get(kind, 0):2} × {kind}: {why}")
    betrayed = sum(told.values()) + sum(n for kind, n in silent.items() if kind not in UNBETRAYED)
    print(f"of what bytes betray: {sum(told.values())} of {betrayed}; not told: {UNTOLD}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
