"""Recordings of serial lines: raw bytes, our own log with time stamps, Dynamixel configurators' text."""
