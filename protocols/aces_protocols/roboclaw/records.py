"""Record types of roboclaw, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import roboclaw

__getattr__ = record_types(roboclaw)
