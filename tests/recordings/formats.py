"""A small recording of each format that can be read, made here: what the tests of all formats are run over.

A format is added with one line: its name as in `aces_bus.recordings.formats`, a recording, its kind, the frames in it.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from aces_bus import Frame, FrameTable
from aces_bus.recordings.base import CanRecording, Chunk, SerialRecording
from aces_bus.recordings.write import open_writer

#: What recordings made by our writers hold.
FRAMES = [
    Frame(0x123, bytes(range(8)), 1_500_000_000.5, "0", is_rx=True),
    Frame(0x18FEF100, b"\x01\x02", 1_500_000_001.25, "1", is_extended_id=True, is_rx=False),
    Frame(0x7FF, b"", 1_500_000_002.0, "0", is_remote_frame=True, is_rx=True, dlc=3),
    Frame(0x321, bytes(range(12)), 1_500_000_002.5, "0", is_fd=True, bitrate_switch=True, is_rx=True),
]


@dataclass(frozen=True)
class Sample:
    """A recording. `lines`: it is text, and what is counted are its lines."""

    format: str
    make: Callable[[], bytes]
    kind: Literal["lines", "binary"]
    frames: int

    @property
    def content(self) -> bytes:
        """Its bytes."""
        return self.make()


def text(content: str) -> Callable[[], bytes]:
    """A text file, written out here."""
    return lambda: content.lstrip("\n").encode()


def written(form: str) -> Callable[[], bytes]:
    """What our writer makes of `FRAMES`."""

    def make() -> bytes:
        file = io.BytesIO()
        with open_writer(file, form) as writer:
            writer.write(FrameTable.from_frames(FRAMES))
        return file.getvalue()

    return make


def serial_log() -> bytes:
    """Two chunks of a serial line."""
    file = io.BytesIO()
    with open_writer(file, "slog") as writer:
        writer.write(Chunk(b"\xff\xff\x01\x02\x01\xfb", 1.5, "to device"))
        writer.write(Chunk(b"\xff\xff\x01\x02\x00\xfc", 1.6, "from device"))
    return file.getvalue()


ASC = """
date Sam Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sam Sep 30 15:06:13.191 2017
   0.000000 Start of measurement
   0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
   1.015991 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   3.098426 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
   3.148421 2  6F9             Tx   d 2 05 0C
   3.197743 1  J1939TP FEE3p        6    0  0   -   Rx   d 9 A0 0F A6 60 3B D1 40 1F DE
   3.200000 2  ErrorFrame\tFlags = 0xe\tCodeExt = 0x20a2 Code = 0x82
   3.300000 1  300             Rx   r 8
   3.400000 CANFD   1 Rx        30a  Generic_Name_12     1 0 9 12 01 02 03 04 05 06 07 08 09 0a 0b 0c   0 0 303000 0 0 0 0 0
   3.500000 Li 1 Rx 2 11 22

   3.600000 1  123             Rx   d 2 11
End TriggerBlock
"""

TRC = """
;$FILEVERSION=2.1
;$STARTTIME=41766.4648963872
;$COLUMNS=N,O,T,B,I,d,R,L,D
;
;   Start time: 07.05.2015 11:09:27.047.8
;---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --
      1      1059.900 DT 1      0300 Rx -  7    00 00 00 00 04 00 00
      2      1283.231 DT 2  18EFC034 Tx -  8    01 02 03 04 05 06 07 08
      3      1334.416 FB 1      0500 Tx -  9    01 02 03 04 05 06 07 08 09 0A 0B 0C
      4      1334.222 ER 1         - Rx -  5    04 00 02 00 00
      5      1334.224 EV 1  User-defined event for bus 1
      6      1334.231 ST 1         - Rx -  4    00 00 00 08

      7      1336.543 RR 1      0100 Rx -  3
      8      1336.600 XX 1      0100 Rx -  3
"""

TRC_OLD = """
;##########################################################################
;    CAN activities recorded by PCAN Explorer
     1)      1841      0001  8  00 00 00 00 00 00 00 00
     2)      1842      0008  4  ERROR 00 19 08 08
     3)      1843  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT
     4)      1844      0100  3  RTR
     5)      1845  18FEF100  1  0G
"""

BUSMASTER = """
***BUSMASTER Ver 2.4.0***
***PROTOCOL CAN***
***[START LOGGING SESSION]***
***START DATE AND TIME 8:8:2014 11:49:7:965***
***HEX***
***SYSTEM MODE***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
11:49:12:9420 Rx 1 0x023 s 1 40
11:49:12:9440 Tx 2 0x18FEF100 x 8 03 E0 00 00 C0 00 00 00
11:49:12:9450 Rx 1 0x023 sr 4
11:49:12:9460 ERR 1

11:49:12:9470 Rx 1 0x023 s 2 40
***[STOP LOGGING SESSION]***
"""

CRTD = """
169.971289 CXX Info Type:crtd; Path:'/sd/can3.crtd'; Filter:3:0-ffffffff; Vehicle:TSHK;
1542473901.020305 1R11 213 00 00 00 00 c0 01 00 00
1542473901.020970 2T29 18DB33F1 2 1 c
1542473902.299819 CEV vehicle.alert this is a textual vehicle alert

1542473903.021560 R11 408 0G
"""

GVRET = """
Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
18970798,000005F4,false,Rx,0,8,00,09,1C,46,00,00,00,01,
18970900,18DAF110,true,Tx,1,2,02,1A,00,00,00,00,00,00,
18970950,000005F4,false,Rx,0,12,00,01,02,03,04,05,06,07,08,09,0A,0B,

18971000,000005F4,false,Rx,0,3,00,09
"""

CSV = """
timestamp,arbitration_id,extended,remote,error,dlc,data
1483389946.197,0xdadada,1,0,0,7,WzQyLCA5XQ==
1483389946.25,0x123,0,1,0,3,
1483389946.5,0x0,0,0,1,0,

1483389946.75,0x123,0,0,0,7,WzQ
"""

MICROCHIP = """
//---------------------------------
Microchip Technology Inc.
CAN BUS Analyzer
Logging Started: 23/9/2015 22:17:43
//---------------------------------
166064;RX;0x21A;8;0xFE;0x36;0x12;0xFE;0x69;0x05;0x07;0xAD;
166.0705;TX;0x1CFE5FFEx;3;0x01;0x01;0x00;;;;;;

166065;RX;0x65;64;;;;;;;;;
"""

ID_CSV = """
# some tool
Timestamp [ms];Channel;CAN ID (hex);DLC;D0;D1;D2;D3;D4;D5;D6;D7
17.4;1;18FEF100;2;01;0A;;;;;;
18;can0;0x123;8;00;01;02;03;04;05;06;07

19;1;123;3;01;0A;;;;;;
"""

CANDUMP = """
(1436509052.249713) can0 044#2A366C2BBA
(1436509052.449713) can1 18FEF100#2A.36 R
(1436509052.549713) can0 123##1AABB
(1436509052.649713) can0 123#R8

(1436509052.749713) can0 123#1
"""

DXCONF = """
Port opened by process "DXCONF.exe" (PID: 2568)

 FF FF 01 02 01 FB   ......

Port closed
"""

SAMPLES: tuple[Sample, ...] = (
    Sample("asc", text(ASC), "lines", 5),
    Sample("trc", text(TRC), "lines", 5),
    Sample("trc", text(TRC_OLD), "lines", 3),
    Sample("busmaster", text(BUSMASTER), "lines", 4),
    Sample("crtd", text(CRTD), "lines", 2),
    Sample("gvret", text(GVRET), "lines", 3),
    Sample("csv", text(CSV), "lines", 3),
    Sample("microchip", text(MICROCHIP), "lines", 2),
    Sample("id-csv", text(ID_CSV), "lines", 2),
    Sample("candump", text(CANDUMP), "lines", 4),
    Sample("asc", written("asc"), "lines", 4),
    Sample("trc", written("trc"), "lines", 4),
    Sample("pcapng", written("pcapng"), "binary", 4),
    Sample("slog", serial_log, "binary", 0),
    Sample("dxconf", text(DXCONF), "lines", 0),
)

#: Formats without a recording here, each with the reason.
ELSEWHERE = {
    "raw": "any bytes are one; nothing tells it",
    "blf": "test_blf.py: its files are packed, and damaged there from within",
    "pcap": "test_pcap.py, with every header a file may have",
    "mf4": "test_mdf4.py: its blocks are damaged there from within",
    "sqlite": "made and damaged with the database's own tools in its tests",
}


def accounted(capture: CanRecording | SerialRecording) -> None:
    """Each line or object that was read is one of the kinds."""
    frames = capture.frames if isinstance(capture, CanRecording) else 0
    parts = (
        capture.lines_unreadable + capture.lines_comment + capture.lines_blank + sum(capture.others.values())
    )
    if isinstance(capture, CanRecording):
        assert capture.lines == frames + parts, (capture.lines, frames, capture.problems, capture.others)
    assert len(capture.problems) == min(5, capture.lines_unreadable)
    assert all(count > 0 for count in capture.others.values())
