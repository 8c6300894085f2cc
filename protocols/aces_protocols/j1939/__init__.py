"""SAE J1939, as an engine's control unit speaks it: what it sends, requests, its name, its faults."""
