"""Formats of recordings that the core does not need: Vector's, PEAK's, Wireshark's, MF4, BUSMASTER, CRTD and others.

They are entry points of the groups `aces_bus.readers` and `aces_bus.writers`, as a stranger's formats are. Only their first
bytes are known here: a reader or writer is imported when its format is used.
"""

from __future__ import annotations

from aces_bus.recordings.beginnings import begins
from aces_bus.recordings.open import RecordingFormat
from aces_bus.recordings.write import FormatOut

from .beginnings import (
    BLF,
    MDF,
    PCAP,
    is_asc,
    is_busmaster,
    is_crtd,
    is_gvret,
    is_id_csv,
    is_microchip,
    is_pcapng,
    is_trc,
)

#: Most specific first.
READERS: tuple[RecordingFormat, ...] = (
    RecordingFormat("blf", "Vector BLF log", "can", begins(BLF), "aces_lab.formats.blf.reader:BlfCapture"),
    RecordingFormat("asc", "Vector ASC log", "can", is_asc, "aces_lab.formats.asc:AscCapture"),
    RecordingFormat(
        "mf4", "ASAM MDF 4 bus log", "can", begins(*MDF), "aces_lab.formats.mf4.reader:Mf4Capture"
    ),
    RecordingFormat("pcap", "pcap capture", "can", begins(*PCAP), "aces_lab.formats.pcap.reader:PcapCapture"),
    RecordingFormat(
        "pcapng", "pcapng capture", "can", is_pcapng, "aces_lab.formats.pcap.pcapng:PcapngCapture"
    ),
    RecordingFormat("trc", "PEAK trace", "can", is_trc, "aces_lab.formats.trc:TrcCapture"),
    RecordingFormat(
        "busmaster", "BUSMASTER log", "can", is_busmaster, "aces_lab.formats.busmaster:BusmasterCapture"
    ),
    RecordingFormat("crtd", "CRTD log", "can", is_crtd, "aces_lab.formats.crtd:CrtdCapture"),
    RecordingFormat("gvret", "SavvyCAN GVRET CSV", "can", is_gvret, "aces_lab.formats.gvret:GvretCapture"),
    RecordingFormat(
        "microchip",
        "Microchip CAN analyser log",
        "can",
        is_microchip,
        "aces_lab.formats.microchip:MicrochipCapture",
    ),
    RecordingFormat(
        "id-csv",
        "CSV with named columns (time, id, data …)",
        "can",
        is_id_csv,
        "aces_lab.formats.id_csv:IdCsvCapture",
    ),
)
WRITERS: tuple[FormatOut, ...] = (
    FormatOut(
        "asc",
        (".asc",),
        "Vector ASC",
        "can",
        "aces_lab.formats.asc_writer",
        "AscWriter",
        is_text=True,
        grows=True,
    ),
    FormatOut(
        "blf",
        (".blf",),
        "Vector BLF",
        "can",
        "aces_lab.formats.blf.writer",
        "BlfWriter",
        needs_seek=True,
        grows=True,
    ),
    FormatOut(
        "mf4", (".mf4",), "ASAM MDF 4", "can", "aces_lab.formats.mf4.writer", "Mf4Writer", needs_seek=True
    ),
    FormatOut(
        "trc",
        (".trc",),
        "PEAK TRC 2.1",
        "can",
        "aces_lab.formats.trc_writer",
        "TrcWriter",
        is_text=True,
        grows=True,
    ),
    FormatOut(
        "pcapng",
        (".pcapng",),
        "pcapng of SocketCAN",
        "can",
        "aces_lab.formats.pcap.writer",
        "PcapngWriter",
        grows=True,
    ),
    FormatOut(
        "gvret",
        (".gvret.csv", ".gvret", ".csv"),
        "SavvyCAN's GVRET CSV",
        "can",
        "aces_lab.formats.gvret_writer",
        "GvretWriter",
        is_text=True,
        grows=True,
    ),
)
