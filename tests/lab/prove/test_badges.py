"""Badges say what was proved, and turn stale when text or declaration change."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from aces_bus import list_protocols, load_protocol
from aces_bus.protocol import Protocol
from aces_tools import proofs


@pytest.mark.slow
def test_no_badge_of_a_shipped_protocol_is_stale() -> None:
    """After a change of a spec or of the generator: make prove."""
    badges = proofs.read_badges()
    stale = [n for n, badge in badges.items() if badge.hash != proofs.protocol_hash(load_protocol(n))]
    assert stale == [], "run make prove"
    assert set(badges) == {
        n for n in list_protocols() if (load_protocol(n).place.file).count("aces_protocols")
    }


def test_a_change_makes_a_badge_stale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same protocol with another constant is not the one that was proved."""
    from construct import Byte, Const, Int16ul, Struct

    def made(constant: bytes) -> Protocol:
        protocol = Protocol("toy", link="can")
        protocol.message("State", id=0x10, payload=Struct(Const(constant), "speed" / Int16ul, "mode" / Byte))
        return protocol

    file = tmp_path / "proved.json"
    badge = proofs.Badge("proved 1", "proved 1", "2026-01-01", "1", "4", proofs.protocol_hash(made(b"\x01")))
    file.write_bytes(msgspec.json.encode({"toy": badge}))
    monkeypatch.setattr(proofs, "badges_path", lambda: file)
    assert proofs.badge_text(made(b"\x01")).startswith("proved 1 (2026-01-01")
    assert proofs.badge_text(made(b"\x02")).startswith("stale: ")
    assert proofs.badge_text(Protocol("other", link="can")).startswith("not proved")
