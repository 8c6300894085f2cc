"""CRSF (Crossfire), the serial protocol of radio-control links: TBS Crossfire and Tracer, ExpressLRS, Betaflight, EdgeTX."""
