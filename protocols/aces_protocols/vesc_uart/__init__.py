"""VESC motor controllers on UART, USB and TCP; the packets that CAN carries in pieces."""
