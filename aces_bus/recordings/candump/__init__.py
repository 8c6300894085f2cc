"""Logs of can-utils: lines as frames, one by one and as columns."""
