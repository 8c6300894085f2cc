"""Device drivers and their simulated twins, one folder each.

Empty for now: drivers arrive with the device floor. Until then a device is spoken to through its protocol
(see `aces_protocols`).
"""
