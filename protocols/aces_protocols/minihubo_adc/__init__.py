"""The analogue-to-digital converter board of MiniHubo."""
