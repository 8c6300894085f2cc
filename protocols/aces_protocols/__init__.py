"""The protocols that ship with aces-bus, one folder each: `spec.py` declares it, `README.md` names its sources.

Nothing is imported here. A protocol is found by name through the entry-point group `aces_bus.protocols`, which is
also how a package of your own adds one; `aces_bus.load_protocol` imports it on use.
"""
