"""Record types of damiao_fd, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import damiao_fd

__getattr__ = record_types(damiao_fd)
