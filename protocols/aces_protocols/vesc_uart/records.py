"""Record types of vesc_uart, for `isinstance` and `match`; editors read the stub beside it."""

from aces_bus.protocol import record_types

from .spec import vesc_uart

__getattr__ = record_types(vesc_uart)
