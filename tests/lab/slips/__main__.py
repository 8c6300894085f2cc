"""What `aces spec check` says of each slip, its recording at hand: `python -m tests.lab.slips [CLASS|SPEC …]`

Nothing is drawn by chance: the same table each time. The status is 1 where less than 85 % of what bytes can betray is told.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from aces_tools.main import main as aces

from .table import SLIPS, UNBETRAYED, Slip
from .traffic import record

HERE = Path(__file__).parent
#: Share of what bytes can betray that has to end with status 1.
WANTED = 0.85
#: How long the laws are asked: they are not what is measured here.
LAWS = "0"


class Told(NamedTuple):
    """What the check said of a slip: its status, and the rules of its errors and warnings."""

    slip: Slip
    status: int
    rules: tuple[str, ...]


def tell(slips: Sequence[Slip]) -> Iterator[Told]:
    """Check each slip's spec against the recording of its device."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = record(folder)
        for name, recording in recordings.items():
            status, said = checked(HERE / f"{name}_spec.py", recording)
            assert status == 0, f"{name} is wrong without a slip: {said}"
        for number, slip in enumerate(slips):
            text = (HERE / f"{slip.spec}_spec.py").read_text("utf-8")
            assert text.count(slip.old) == 1, (
                f"{slip.spec}: {slip.old!r} is there {text.count(slip.old)} times"
            )
            path = folder / f"slip{number}.py"
            # What a slip names is there: a name that is not imported is no slip of the sheet.
            text = text.replace("from construct import", "from construct import *\nfrom construct import", 1)
            path.write_text(text.replace(slip.old, slip.new), "utf-8")
            status, out = checked(path, recordings[slip.spec])
            lines = [line for line in out.splitlines() if ": error: " in line or ": warning: " in line]
            yield Told(slip, status, tuple(dict.fromkeys(line.rpartition("[")[2][:-1] for line in lines)))


def checked(spec: Path, recording: Path) -> tuple[int, str]:
    """Return the status and the output of the check."""
    call = ["spec", "check", str(spec), "--for", LAWS, "--against", str(recording)]
    if recording.suffix == ".bin":
        call += ["--direction", "both"]
    out, said = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(said):
        status = aces(call)
    return status, out.getvalue() + said.getvalue()


def main(words: Sequence[str]) -> int:
    slips = [slip for slip in SLIPS if not words or slip.kind in words or slip.spec in words]
    caught, total = Counter[str](), Counter[str]()
    for told in tell(slips):
        slip = told.slip
        total[slip.kind] += 1
        caught[slip.kind] += told.status == 1
        print(
            f"{'told  ' if told.status == 1 else 'silent'}  {slip.kind:8} {slip.spec:7} {slip.what:40}"
            f" {', '.join(told.rules)}"
        )
    print()
    for kind, number in total.items():
        print(f"{kind:8} {caught[kind]:3} of {number:3}  {UNBETRAYED.get(kind, '')}")
    open_to_bytes = [kind for kind in total if kind not in UNBETRAYED]
    seen, all_ = sum(caught[k] for k in open_to_bytes), sum(total[k] for k in open_to_bytes)
    print(
        f"of what bytes can betray: {seen} of {all_}; of all: {sum(caught.values())} of {sum(total.values())}"
    )
    return int(seen < WANTED * all_)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
