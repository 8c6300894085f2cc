"""Device drivers and their simulated twins, one folder each.

Robots are here already, as TOML files (`robots/`); drivers arrive with the device floor. Until then a device is spoken to
through its protocol (see `aces_protocols`).
"""
