"""Small robots with boards of every kind, for tests and the conformance kit.

1. Joints, gears, directions and home data are those of the robots (facts, section 12); the robots are not.
2. 0.2 s is no multiple of their tick: an answer late by whole ticks looks like a prompt one to the next request.
"""

from __future__ import annotations

#: D12: boards of 1, 2 and 5 channels.
D12 = """
name = "hubo_motor_boards"
doc = "motor boards of 2, 1 and 5 channels, firmware D12"
rate_hz = 28

[buses]
upper = { link = "can", protocol = "hubo", dialect = "D12", bitrate = 1_000_000 }

[devices]
JMC0  = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x00 }, channels = 2, settings = { status_s = 0.25, current_s = 0.5 } }
JMC1  = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x01 }, channels = 1, settings = { status_s = 0.25, current_s = 0.5 } }
EJMC4 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x24 }, channels = 5, settings = { status_s = 0.25, current_s = 0.5 } }

[joints]
RHY = { device = "JMC0",  channel = 0, gear = [10, 25],    harmonic = 100, encoder = 4000, lower = -1.92, upper = 1.92, compliance = { kp = 80, kd = 0, max_pwm = 8 } }
RHR = { device = "JMC0",  channel = 1, gear = [324, 1024], harmonic = 160, encoder = 4000, lower = -0.52, upper = 0.52, compliance = { kp = 70, kd = 1, max_pwm = 7 } }
RHP = { device = "JMC1",  channel = 0, gear = [16, 20],    harmonic = 160, encoder = 4000, lower = -1.57, upper = 1.57 }
RF1 = { device = "EJMC4", channel = 0, gear = [1, 1],      harmonic = 256, encoder = 128, lower = -3.14, upper = 3.14, command = "duty", max_duty = 100 }
RF2 = { device = "EJMC4", channel = 1, gear = [1, 1],      harmonic = 256, encoder = 128, lower = -3.14, upper = 3.14, command = "duty", max_duty = 100 }
RF3 = { device = "EJMC4", channel = 2, gear = [1, 1],      harmonic = 256, encoder = 128, lower = -3.14, upper = 3.14, command = "duty", max_duty = 100 }
RF4 = { device = "EJMC4", channel = 3, gear = [1, 1],      harmonic = 256, encoder = 128, lower = -3.14, upper = 3.14, command = "duty", max_duty = 100 }
RF5 = { device = "EJMC4", channel = 4, gear = [1, 1],      harmonic = 256, encoder = 128, lower = -3.14, upper = 3.14, command = "duty", max_duty = 100 }
"""

#: D12: a board of 3 channels, which has no references, and DRC-Hubo's hand and neck.
D12_THREE = """
name = "hubo_motor_hands"
doc = "a neck of three motors, DRC-Hubo's hand and neck, firmware D12"
rate_hz = 28

[buses]
upper = { link = "can", protocol = "hubo", dialect = "D12", bitrate = 1_000_000 }

[devices]
EJMC0 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x20 }, channels = 3, settings = { status_s = 0.25, current_s = 0.5 } }
EJMC1 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x21 }, channels = 3, kind = "hand", settings = { status_s = 0.25, current_s = 0.5 } }
EJMC2 = { driver = "hubo_motor", bus = "upper", credentials = { board = 0x22 }, channels = 3, kind = "neck", settings = { status_s = 0.25, current_s = 0.5 } }

[joints]
P1  = { device = "EJMC0", channel = 0, gear = [1, 1],      harmonic = 100, encoder = 128,  lower = -3.14, upper = 3.14, command = "duty", max_duty = 50 }
P2  = { device = "EJMC0", channel = 1, gear = [1, 1],      harmonic = 100, encoder = 128,  lower = -3.14, upper = 3.14, command = "duty", max_duty = 50 }
P3  = { device = "EJMC0", channel = 2, gear = [1, 1],      harmonic = 100, encoder = 128,  lower = -3.14, upper = 3.14, command = "duty", max_duty = 50 }
RWR = { device = "EJMC1", channel = 0, gear = [1, 2],      harmonic = 100, encoder = 128 }
RH1 = { device = "EJMC1", channel = 1, gear = [1, 1],      harmonic = 256, encoder = 128, command = "current", max_current = 0.1 }
RH2 = { device = "EJMC1", channel = 2, gear = [1, 1],      harmonic = 256, encoder = 128, command = "current", max_current = 0.1 }
NKY = { device = "EJMC2", channel = 0, gear = [1, 1],      harmonic = 1,   encoder = 4096, zero = 3.141592653589793 }
NK1 = { device = "EJMC2", channel = 1, gear = [1, 1],      harmonic = 1,   encoder = 4096, zero = 3.141592653589793 }
NK2 = { device = "EJMC2", channel = 2, gear = [1, 1],      harmonic = 1,   encoder = 4096, zero = 3.141592653589793 }
"""

#: D08: boards of 1, 2, 3 and 5 channels.
D08 = """
name = "hubo_motor_boards_d08"
doc = "one motor board of each kind, firmware D08"
rate_hz = 28

[buses]
lower = { link = "can", protocol = "hubo", dialect = "D08", bitrate = 1_000_000 }

[devices]
JMC0  = { driver = "hubo_motor", bus = "lower", credentials = { board = 0x00 }, channels = 2, settings = { period_ms = 10, status_s = 0.25, current_s = 0.5 } }
JMC1  = { driver = "hubo_motor", bus = "lower", credentials = { board = 0x01 }, channels = 1, settings = { period_ms = 10, status_s = 0.25, current_s = 0.5 } }
EJMC0 = { driver = "hubo_motor", bus = "lower", credentials = { board = 0x20 }, channels = 3, settings = { period_ms = 10, status_s = 0.25, current_s = 0.5 } }
EJMC4 = { driver = "hubo_motor", bus = "lower", credentials = { board = 0x24 }, channels = 5, settings = { period_ms = 10, status_s = 0.25, current_s = 0.5 } }

[joints]
RHY = { device = "JMC0",  channel = 0, gear = [10, 25],    harmonic = 100, encoder = 4000, direction = -1, lower = -1.0, upper = 1.0, home = { offset = -18600, direction = "ccw", search_turns = 10, z_phase = 3460 }, gains = { kp = 200, ki = 0, kd = 500 } }
RHR = { device = "JMC0",  channel = 1, gear = [324, 1024], harmonic = 160, encoder = 4000, direction = 1,  lower = -1.0, upper = 1.0, home = { offset = 15000, direction = "cw", search_turns = 10, z_phase = 3909 }, gains = { kp = 200, ki = 0, kd = 500 } }
RHP = { device = "JMC1",  channel = 0, gear = [16, 20],    harmonic = 160, encoder = 4000, direction = 1,  lower = -2.0, upper = 2.0, home = { offset = 3800, direction = "cw", search_turns = 10, z_phase = 2561 }, gains = { kp = 200, ki = 0, kd = 500 } }
RWY = { device = "EJMC0", channel = 0, gear = [1, 1],      harmonic = 100, encoder = 128,  direction = 1,  lower = -2.0, upper = 2.0, home = { offset = -72000, direction = "ccw", search_turns = 10 }, gains = { kp = 15, ki = 0, kd = 15 } }
RW1 = { device = "EJMC0", channel = 1, gear = [1, 1],      harmonic = 100, encoder = 128,  direction = 1, home = { offset = 0, direction = "cw", search_turns = 10 }, gains = { kp = 15, ki = 0, kd = 15 } }
RW2 = { device = "EJMC0", channel = 2, gear = [1, 1],      harmonic = 100, encoder = 128,  direction = 1,  lower = -2.0, upper = 2.0, home = { offset = 0, direction = "cw", search_turns = 10 }, gains = { kp = 15, ki = 0, kd = 15 } }
RF1 = { device = "EJMC4", channel = 4, command = "duty", max_duty = 15, home = { power = 4 } }
RF2 = { device = "EJMC4", channel = 0, command = "duty", max_duty = 15, home = { power = 4 } }
RF3 = { device = "EJMC4", channel = 1, command = "duty", max_duty = 15, home = { power = 4 } }
RF4 = { device = "EJMC4", channel = 2, command = "duty", max_duty = 15, home = { power = 4 } }
RF5 = { device = "EJMC4", channel = 3, command = "duty", max_duty = 15, home = { power = 4 } }
"""

#: The vendor's sheet alone: D08's robot without the hand, which that sheet has no status of.
D08X = "\n".join(
    line
    for line in D08.replace('dialect = "D08"', 'dialect = "D08X"')
    .replace("boards_d08", "boards_d08x")
    .splitlines()
    if "EJMC4" not in line
)
