"""Search for what breaks a device: `aces device fuzz`."""
