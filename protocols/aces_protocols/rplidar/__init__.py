"""SLAMTEC RPLIDAR: laser scanners that turn, on a serial line."""
