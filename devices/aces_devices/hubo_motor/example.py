"""Small robots with boards of every kind, for tests and the conformance kit: the TOML files in `examples`.

1. Together they have every row of `shapes`, except a hand of D08X, of which that sheet has no reply at all.
"""

from __future__ import annotations

from importlib.resources import files


def _read(name: str) -> str:
    return (files("aces_devices.hubo_motor") / "examples" / f"{name}.toml").read_text(encoding="utf-8")


#: D12: boards of 1, 2 and 5 channels; of 3, and DRC-Hubo's hand and neck. D08: boards of 1, 2, 3 and 5 channels.
D12, D12_THREE, D08 = (_read(name) for name in ("d12", "d12_three", "d08"))

#: The robot of D08 by the vendor's sheet alone, without the hand.
D08X = "\n".join(
    line
    for line in D08.replace('dialect = "D08"', 'dialect = "D08X"')
    .replace("boards_d08", "boards_d08x")
    .splitlines()
    if "EJMC4" not in line
)
