"""Modbus RTU: registers and bits of any device on a serial line."""
