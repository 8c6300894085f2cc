"""A whole recording decoded at once: a table per message, with NumPy."""
