"""SBF, the binary protocol of Septentrio receivers."""
