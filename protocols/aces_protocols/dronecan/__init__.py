"""DroneCAN (UAVCAN v0), as speed controllers of motors (ESCs) speak it."""
