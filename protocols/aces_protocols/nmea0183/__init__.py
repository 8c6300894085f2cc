"""NMEA 0183, the sentences of satellite receivers and compasses."""
