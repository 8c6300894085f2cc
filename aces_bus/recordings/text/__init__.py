"""Text formats with a line per frame: ASC, TRC, and what exports CSV or something like it."""
