"""HuboVia: joint commands by UDP to the Windows control PC of a Hubo 2."""
