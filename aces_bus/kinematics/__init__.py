"""Serial chains: where the tips of a body are, and how they move with its joints."""

from __future__ import annotations

from .bodies import load_body

__all__ = ["load_body"]
