"""Files of other tools, imported for a test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from aces_bus import Frame, make_scanner
from aces_bus.protocol.exchange import load_database
from aces_bus.protocol.exchange.problems import ImportedProtocol
from aces_bus.testing import laws
from aces_bus.testing.source import spread

HEAD = 'VERSION ""\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tBA_\n\nBS_:\n\nBU_: ECU Gate\n\n'
#: Lines of HEAD; the first line of what follows is one more.
ABOVE = HEAD.count("\n")


def imported(tmp_path: Path, body: str, name: str = "car.dbc", encoding: str = "utf-8") -> ImportedProtocol:
    path = tmp_path / name
    path.write_bytes((HEAD + body if name.endswith(".dbc") else body).encode(encoding))
    return load_database(path)


def decoded(found: ImportedProtocol, *frames: Frame) -> list[Any]:
    return make_scanner([found.protocol.variant()], include_unknown=True, direction="both").feed(frames)


def reasons(found: ImportedProtocol) -> list[tuple[int, str]]:
    """(line of the body, reason) of each problem."""
    return [(problem.line - ABOVE, problem.reason) for problem in found.problems]


def laws_hold(found: ImportedProtocol, scenes: int = 4) -> None:
    """The laws of CAN on drawn scenes: round trip, oracle and columns, calm, …"""
    variant = found.protocol.variant()
    for law in laws.LAWS:
        if law.streams_only:
            continue
        for seed in range(scenes):
            law(variant, "both", *laws.draw_arguments(law, variant, "both", spread(seed)))


CAR = """BO_ 100 Speed: 5 ECU
 SG_ speed : 0|16@1+ (0.01,-10) [0|250] "km/h" Gate
 SG_ gear : 16|3@1- (1,0) [0|0] "" Gate
 SG_ temperature : 31|8@0+ (0.5,-40) [-40|87] "°C" Gate
BO_ 200 Large: 20 ECU
 SG_ late : 152|8@1+ (2,1) [0|0] "" Gate
CM_ BO_ 100 "How fast it goes.
On every road.";
CM_ SG_ 100 speed "measured at the \\"left\\" wheel";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 100 50;
VAL_ 100 gear -1 "reverse" 0 "neutral" ;
VAL_ 100 temperature 255 "not available" 254 "error" ;
"""

MUX = """BO_ 300 Mux: 8 ECU
 SG_ page M : 0|4@1+ (1,0) [0|0] "" Gate
 SG_ first m0 : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ inner m1M : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ deep m2 : 16|32@1- (1,0) [0|0] "" Gate
 SG_ twisted m0 : 17|32@1- (0.5,0) [0|0] "" Gate
SG_MUL_VAL_ 300 first page 0-0;
SG_MUL_VAL_ 300 inner page 1-1, 3-5;
SG_MUL_VAL_ 300 deep inner 2-9, 200-200;
SG_MUL_VAL_ 300 twisted page 6-6;
SIG_VALTYPE_ 300 deep : 1;
SIG_VALTYPE_ 300 twisted : 1;
BO_ 301 Simple: 8 ECU
 SG_ which M : 7|4@0+ (1,0) [0|0] "" Gate
 SG_ one m1 : 15|16@0- (0.1,0) [0|0] "V" Gate
 SG_ two m2 : 15|8@0+ (1,0) [0|0] "" Gate
 SG_ always : 56|8@1+ (1,0) [0|0] "" Gate
VAL_ 301 which 1 "one" 2 "two" 3 "nothing" ;
"""

EDS = """[DeviceInfo]
VendorName=Nobody
[1800]
ParameterName=TPDO1
ObjectType=9
[1800sub1]
ParameterName=COB-ID
DataType=7
AccessType=rw
DefaultValue=$NODEID+0x40000180
[1A00]
ParameterName=Mapping
ObjectType=9
[1A00sub0]
ParameterName=Entries
DataType=5
AccessType=rw
DefaultValue=4
[1A00sub1]
ParameterName=a
DataType=7
AccessType=rw
DefaultValue=0x60410010
[1A00sub2]
ParameterName=b
DataType=7
AccessType=rw
DefaultValue=0x00010003
[1A00sub3]
ParameterName=c
DataType=7
AccessType=rw
DefaultValue=0x60640015
[1A00sub4]
ParameterName=d
DataType=7
AccessType=rw
DefaultValue=0x20000110
[6041]
ParameterName=Status word
DataType=6
AccessType=ro
[6064]
ParameterName=Position
DataType=4
AccessType=ro
[2000]
ParameterName=Other
ObjectType=9
[2000sub1]
ParameterName=Current
DataType=3
AccessType=ro
[1400]
ParameterName=RPDO1
ObjectType=9
[1400sub1]
ParameterName=COB-ID
DataType=7
AccessType=rw
DefaultValue=0x80000200
[1600]
ParameterName=Mapping
ObjectType=9
[1600sub0]
ParameterName=Entries
DataType=5
AccessType=rw
DefaultValue=1
[1600sub1]
ParameterName=a
DataType=7
AccessType=rw
DefaultValue=0x60640020
"""
