"""The virtual bus across processes: a server of paced wires, and python-can clients of it."""
