"""The CAN protocol of the Hubo humanoids: Hubo 2, Hubo 2+ and DRC-Hubo."""
