"""Why bytes are decoded as they are: the scanner's decisions, template by template, part by part (the paper's Fig. 5).

>>> from aces_bus.protocol.explain.tracer import Tracer
>>> from aces_protocols.robotis.spec import robotis
>>> tracer = Tracer([robotis.variant()], direction="to device")
>>> (attempt,) = tracer.explain_stream(bytes.fromhex("FF FF 01 02 01 FB"))
>>> attempt.verdict, [step.what for step in attempt.steps]
('Ping', ['sync', 'sync', 'id', 'length', 'instruction', 'check'])
>>> sorted(death.template for death in attempt.steps[3].died)
['Read', 'RegWrite', 'Write']
"""

from __future__ import annotations

from .unknown import why_unknown

__all__ = ["why_unknown"]
