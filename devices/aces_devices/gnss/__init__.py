"""Receivers of satellite navigation: `ubx` for u-blox' own messages, `nmea0183` for everybody's sentences."""
