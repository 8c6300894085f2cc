"""Buses and lines that exist in this process alone: CAN with its physics, serial lines, datagrams."""
