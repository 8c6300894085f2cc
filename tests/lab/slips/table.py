"""85 slips that an author makes with a sheet at hand, in the classes and proportions of trials with real authors.

A slip is (spec, class, what, old text, new text). Classes: what an import refuses; what a rule, a worked example or a
recording contradicts; what only means something else; what the recording does not hold. Of the last two no byte can betray
anything: `UNBETRAYED` says why of each.
"""

from __future__ import annotations

from typing import NamedTuple


class Slip(NamedTuple):
    """One slip: `old` stands once in the spec, and becomes `new`."""

    spec: str
    kind: str
    what: str
    old: str
    new: str


#: Classes of which no byte says anything.
UNBETRAYED = {
    "meaning": "the bytes are the same whatever they are called, and no range, example or name is contradicted",
    "unseen": "the recording does not hold the message or the value",
}

SLIPS = [
    # -------- what an import refuses
    Slip(
        "drive",
        "import",
        "two fields share bits",
        '"life" / Counter(bits(7))',
        '"life" / Counter(bits(7, 48))',
    ),
    Slip("rmd", "import", "one value with two names", "locked=0, released=1", "locked=1, released=1"),
    Slip("rmd", "import", "a bit with two names", '"over_voltage": 3', '"over_voltage": 2'),
    Slip("crsf", "import", "a copied message name", '"Attitude",', '"Link",'),
    # -------- what rules say, or comparison with the rest of the spec
    Slip(
        "rmd",
        "rule",
        "byte order of one number",
        '"current" / Quantity(Int16sl, unit="A", scale=0.01, range',
        '"current" / Quantity(Int16sb, unit="A", scale=0.01, range',
    ),
    Slip(
        "crsf",
        "rule",
        "byte order of one number",
        '"heading" / Quantity(Int16ub',
        '"heading" / Quantity(Int16ul',
    ),
    Slip(
        "blocks",
        "rule",
        "byte order of one number",
        '"accuracy" / Quantity(Int16ul',
        '"accuracy" / Quantity(Int16ub',
    ),
    Slip(
        "groups",
        "rule",
        "byte order of one number",
        'Present("fields", 5, Quantity(Float32l',
        'Present("fields", 5, Quantity(Float32b',
    ),
    Slip(
        "trace",
        "rule",
        "byte order of one number",
        'Present("flags", 4, Quantity(Int32ub',
        'Present("flags", 4, Quantity(Int32ul',
    ),
    Slip(
        "rmd",
        "rule",
        "a copied command",
        'GetAngle = ask("GetAngle", command=0x92',
        'GetAngle = ask("GetAngle", command=0x9C',
    ),
    Slip("drive", "rule", "a copied identifier", "id=Node << 5 | 0x17", "id=Node << 5 | 0x14"),
    Slip(
        "rmd",
        "rule",
        "an answer to the wrong question",
        "command=0x92,\n    reply_to=GetAngle",
        "command=0x92,\n    reply_to=GetMotion",
    ),
    Slip("crsf", "rule", "a unit misspelt", 'unit="mAh"', 'unit="mAH"'),
    Slip("crsf", "rule", "a range wider than its bits", "range=(-1000, 5000)", "range=(-1000, 90000)"),
    Slip(
        "drive",
        "rule",
        "a direction reversed",
        '"Currents",\n    id=Node << 5 | 0x14,\n    direction="from device"',
        '"Currents",\n    id=Node << 5 | 0x14,\n    direction="to device"',
    ),
    Slip("blocks", "rule", "max_size too small", "max_size=512", "max_size=80"),
    # -------- what a worked example contradicts
    Slip(
        "rmd",
        "example",
        "command of another message",
        '    "Status",\n    command=0x9A',
        '    "Status",\n    command=0x9B',
    ),
    Slip("rmd", "example", "scale off by ten", 'unit="V", scale=0.1', 'unit="V", scale=0.01'),
    Slip(
        "rmd",
        "example",
        "scale off by ten",
        '"speed" / Quantity(Int32sl, unit="°/s", scale=0.01)',
        '"speed" / Quantity(Int32sl, unit="°/s", scale=0.1)',
    ),
    Slip("rmd", "example", "enumeration swapped", "locked=0, released=1", "locked=1, released=0"),
    Slip(
        "rmd",
        "example",
        "a flag bit off by one",
        '"low_voltage": 2, "over_voltage": 3',
        '"low_voltage": 3, "over_voltage": 2',
    ),
    Slip(
        "rmd",
        "example",
        "a reserved byte forgotten",
        '        "zero" / Reserved(1),\n        "brake"',
        '        "brake"',
    ),
    Slip(
        "rmd",
        "example",
        "reserved bytes one too few",
        '"zero" / Reserved(3), "speed"',
        '"zero" / Reserved(2), "speed"',
    ),
    Slip("rmd", "example", "a float read as an integer", '"value" / Float32l', '"value" / Int32ul'),
    Slip("rmd", "example", "the answers' identifier", "id=0x240 + Motor", "id=0x140 + Motor"),
    Slip(
        "drive", "example", "two states swapped", '"idle": 1, "calibration": 3', '"idle": 3, "calibration": 1'
    ),
    Slip(
        "drive",
        "example",
        "a flag one bit too high",
        '"watchdog": 24, "estop": 25',
        '"watchdog": 25, "estop": 26',
    ),
    Slip(
        "drive",
        "example",
        "fields swapped",
        '"state" / Enumeration(bits(8), STATES),\n        "result" / Enumeration(bits(8), success=0, busy=1)',
        '"result" / Enumeration(bits(8), success=0, busy=1),\n        "state" / Enumeration(bits(8), STATES)',
    ),
    Slip(
        "drive",
        "example",
        "two gains in the wrong order",
        '"velocity" / Quantity(Int16sl, scale=0.001, unit="rev/s"),\n        '
        '"torque" / Quantity(Int16sl, scale=0.001, unit="N·m")',
        '"torque" / Quantity(Int16sl, scale=0.001, unit="N·m"),\n        '
        '"velocity" / Quantity(Int16sl, scale=0.001, unit="rev/s")',
    ),
    Slip(
        "drive",
        "example",
        "signed read as unsigned",
        '"torque" / Quantity(Int16sl',
        '"torque" / Quantity(Int16ul',
    ),
    Slip("drive", "example", "identifier bits shifted", "id=Node << 5 | 0x09", "id=Node << 4 | 0x09"),
    Slip(
        "crsf",
        "example",
        "scale off by ten",
        '"voltage" / Quantity(Int16ub, unit="V", scale=0.1',
        '"voltage" / Quantity(Int16ub, unit="V", scale=0.01',
    ),
    Slip("crsf", "example", "what the check covers", "over=slice(2, -1)", "over=slice(1, -1)"),
    Slip("crsf", "example", "size one too long", "size=this.length + 2", "size=this.length + 3"),
    Slip("crsf", "example", "24 bits read as 16", '"used" / Quantity(Int24ub', '"used" / Quantity(Int16ub'),
    Slip(
        "crsf",
        "example",
        "a range too narrow",
        'unit="V", scale=0.1, range=(0, 60)',
        'unit="V", scale=0.1, range=(0, 20)',
    ),
    # -------- what only the recording contradicts
    Slip("crsf", "against", "another CRC", '"CRC8-DVB-S2"', '"CRC8-SMBUS"'),
    Slip("groups", "against", "another CRC", '"CRC16-XMODEM"', '"CRC16-IBM-3740"'),
    Slip("groups", "against", "start of the check", "over=slice(1, -2)", "over=slice(0, -2)"),
    Slip("blocks", "against", "start of the check", "over=slice(4, None)", "over=slice(2, None)"),
    Slip("groups", "against", "byte order of the check", 'order="big"', 'order="little"'),
    Slip("blocks", "against", "length counts less", "size=this.length + 0", "size=this.length + 8"),
    Slip("trace", "against", "length counts more", "size=this.length + 4", "size=this.length + 0"),
    Slip("drive", "against", "an identifier", "id=Node << 5 | 0x17", "id=Node << 5 | 0x16"),
    Slip("drive", "against", "nodes that the field leaves out", "range(0x3F)", "range(4)"),
    Slip(
        "rmd",
        "against",
        "a command",
        'GetRunTime = ask("GetRunTime", command=0xB1',
        'GetRunTime = ask("GetRunTime", command=0xB2',
    ),
    Slip("crsf", "against", "a type", '"kind": 0x14', '"kind": 0x15'),
    Slip("blocks", "against", "a block's number", '"kind": 5908', '"kind": 5907'),
    Slip(
        "crsf",
        "against",
        "16 bits where there are 32",
        '"longitude" / Quantity(Int32sb',
        '"longitude" / Quantity(Int16sb',
    ),
    Slip(
        "crsf",
        "against",
        "the last field forgotten",
        '(-1000, 5000)),\n        "satellites" / Byte,',
        "(-1000, 5000)),",
    ),
    Slip(
        "rmd",
        "against",
        "signed read as unsigned",
        '"angle" / Quantity(Int32sl',
        '"angle" / Quantity(Int32ul',
    ),
    Slip(
        "blocks",
        "against",
        "double read as float",
        '"height" / Quantity(Float64l',
        '"height" / Quantity(Float32l',
    ),
    Slip("rmd", "against", "addresses", "id=0x240 + Motor", "id=0x250 + Motor"),
    Slip(
        "crsf",
        "against",
        "a name of the enumeration forgotten",
        '"10mW": 1, "25mW": 2, "100mW": 3',
        '"25mW": 2, "100mW": 3',
    ),
    Slip(
        "trace",
        "against",
        "a byte of the header forgotten",
        '"kind" / Byte,\n        "arguments" / Byte,',
        '"kind" / Byte,',
    ),
    # -------- what once was a note, with status 0
    Slip("crsf", "note", "channels of ten bits", "bits(11) for n", "bits(10) for n"),
    Slip("crsf", "note", "a channel forgotten", "range(1, 17)", "range(1, 16)"),
    Slip(
        "crsf",
        "note",
        "channels shifted by four bits",
        '*(f"channel{n}" / bits(11) for n in range(1, 17))',
        '*(f"channel{n}" / bits(11, 11 * n - 7) for n in range(1, 16))',
    ),
    Slip("blocks", "note", "count plus one", "this.count,", "this.count + 1,"),
    Slip("trace", "note", "length of the body only", "size=this.length + 4", "size=this.length + 8"),
    Slip(
        "rmd", "note", "addresses from two on", 'IdField("id", range(1, 33))', 'IdField("id", range(2, 33))'
    ),
    # -------- what a tool can see, and nothing saw
    Slip(
        "crsf",
        "tool",
        "bit order of the layout",
        "for n in range(1, 17))),",
        'for n in range(1, 17)), order="msb"),',
    ),
    Slip(
        "rmd",
        "tool",
        "no direction in all answers",
        'id=0x240 + Motor, direction="from device", ',
        "id=0x240 + Motor, ",
    ),
    Slip("trace", "tool", "a counter that is no Counter", "Counter(Byte)", "Byte"),
    Slip("drive", "tool", "a counter that is no Counter", "Counter(bits(7))", "bits(7)"),
    Slip("blocks", "tool", "the size of a group ignored", "Bytes(this._.group_size - 6)", "Bytes(2)"),
    Slip(
        "blocks",
        "tool",
        "a field left out of a group",
        '                "azimuth" / Quantity(Int16ul, unit="°", range=(0, 360)),\n',
        "",
    ),
    Slip(
        "groups",
        "tool",
        "two flags in the wrong order",
        '"temperature" / Present("fields", 4,',
        '"temperature" / Present("fields", 5,',
    ),
    Slip(
        "trace",
        "tool",
        "optional fields in the wrong order",
        '        "session" / Present("flags", 3, Int32ub),\n'
        '        "time" / Present("flags", 4, Quantity(Int32ub, unit="s", scale=1e-4)),',
        '        "time" / Present("flags", 4, Quantity(Int32ub, unit="s", scale=1e-4)),\n'
        '        "session" / Present("flags", 3, Int32ub),',
    ),
    Slip(
        "blocks",
        "tool",
        "a do-not-use value forgotten",
        '"height" / Quantity(Float64l, unit="m", unknown=(NEVER,), ',
        '"height" / Quantity(Float64l, unit="m", ',
    ),
    # -------- what only means something else
    Slip(
        "rmd",
        "meaning",
        "a wrong unit",
        'Struct("zero" / Reserved(3), "time" / Quantity(Int32ul, unit="ms"))',
        'Struct("zero" / Reserved(3), "time" / Quantity(Int32ul, unit="s"))',
    ),
    Slip(
        "rmd",
        "meaning",
        "a scale off by ten",
        '"angle" / Quantity(Int32sl, unit="°", scale=0.01)',
        '"angle" / Quantity(Int32sl, unit="°", scale=0.1)',
    ),
    Slip(
        "drive",
        "meaning",
        "two alike fields swapped",
        '"set" / Quantity(Float32l, unit="A"), "measured" / Quantity(Float32l, unit="A")',
        '"measured" / Quantity(Float32l, unit="A"), "set" / Quantity(Float32l, unit="A")',
    ),
    Slip(
        "drive",
        "meaning",
        "voltage and current swapped",
        '"voltage" / Quantity(Float32l, unit="V"), "current"',
        '"current" / Quantity(Float32l, unit="V"), "voltage"',
    ),
    Slip(
        "crsf",
        "meaning",
        "a wrong unit",
        '"speed" / Quantity(Int16ub, unit="km/h"',
        '"speed" / Quantity(Int16ub, unit="m/s"',
    ),
    Slip(
        "crsf",
        "meaning",
        "two angles swapped",
        '"pitch" / Quantity(Int16sb, unit="rad", scale=1e-4, range=(-3.2, 3.2)),\n        "roll"',
        '"roll" / Quantity(Int16sb, unit="rad", scale=1e-4, range=(-3.2, 3.2)),\n        "pitch"',
    ),
    Slip("crsf", "meaning", "two powers swapped", '"25mW": 2, "100mW": 3', '"25mW": 3, "100mW": 2'),
    Slip("blocks", "meaning", "modes swapped", "alone=1, differential=2", "alone=2, differential=1"),
    Slip(
        "blocks",
        "meaning",
        "north and east swapped",
        '"north" / Quantity(Float32l, unit="m/s", range=(-100, 100)),\n        "east"',
        '"east" / Quantity(Float32l, unit="m/s", range=(-100, 100)),\n        "north"',
    ),
    Slip(
        "groups",
        "meaning",
        "degrees for radians",
        'axis / Quantity(Float32l, unit="rad/s", range=(-35, 35))',
        'axis / Quantity(Float32l, unit="°/s", range=(-35, 35))',
    ),
    Slip("trace", "meaning", "a scale off by ten", 'unit="s", scale=1e-4', 'unit="s", scale=1e-3'),
    # -------- what the recording does not hold
    Slip("drive", "unseen", "a flag that is never set", '"system": 1', '"system": 2'),
    Slip("drive", "unseen", "a flag that is never set", '"watchdog": 24', '"watchdog": 23'),
    Slip("rmd", "unseen", "a flag that is never set", '"over_voltage": 3', '"over_voltage": 5'),
    Slip("crsf", "unseen", "a name of a value that never comes", '"4fps": 0', '"4fps": 5'),
]
