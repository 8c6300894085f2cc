"""Worked examples of the blocks: packets that pysbf2 1.0.7 builds or reads to the same values; those of the inertial unit
and of external sensors, which it does not know, by hand from the tables.
"""

from __future__ import annotations

EXAMPLES: dict[str, list[tuple[str, dict[str, object]]]] = {
    "PVTCartesian": [
        (
            "24409DDDA64F6000F47C9A17FD080400000000C0FABA4E410000000097BD1241000000D02CC45241000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001011E403200020003004100",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "bases": 1,
                "latency": 0.005,
                "horizontal_accuracy": 0.02,
                "vertical_accuracy": 0.03,
                "x": 4027893.5,
                "y": 307045.75,
                "z": 4919475.25,
                "vx": 1.5,
                "vy": -2.25,
                "vz": 0.5,
                "revision": 2,
            },
        )
    ],
    "PVTCartesianRevision1": [
        (
            "24404BD7A62F5800F47C9A17FD080400000000C0FABA4E410000000097BD1241000000D02CC45241000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001011E40",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "bases": 1,
                "x": 4027893.5,
                "y": 307045.75,
                "z": 4919475.25,
                "vx": 1.5,
                "vy": -2.25,
                "vz": 0.5,
                "revision": 1,
            },
        )
    ],
    "PVTCartesianRevision0": [
        (
            "2440FF94A60F5800F47C9A17FD080400000000C0FABA4E410000000097BD1241000000D02CC45241000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001000000",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "x": 4027893.5,
                "y": 307045.75,
                "z": 4919475.25,
                "vx": 1.5,
                "vy": -2.25,
                "vz": 0.5,
            },
        )
    ],
    "PVTGeodetic": [
        (
            "244031DBA74F6000F47C9A17FD080400000000000000EC3F000000000000B03F0000000000605A40000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001011E403200020003004100",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "bases": 1,
                "latency": 0.005,
                "horizontal_accuracy": 0.02,
                "vertical_accuracy": 0.03,
                "latitude": 0.875,
                "longitude": 0.0625,
                "height": 105.5,
                "v_north": 1.5,
                "v_east": -2.25,
                "v_up": 0.5,
                "revision": 2,
            },
        )
    ],
    "PVTGeodeticRevision1": [
        (
            "24408061A72F5800F47C9A17FD080400000000000000EC3F000000000000B03F0000000000605A40000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001011E40",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "bases": 1,
                "latitude": 0.875,
                "longitude": 0.0625,
                "height": 105.5,
                "v_north": 1.5,
                "v_east": -2.25,
                "v_up": 0.5,
                "revision": 1,
            },
        )
    ],
    "PVTGeodeticRevision0": [
        (
            "24403422A70F5800F47C9A17FD080400000000000000EC3F000000000000B03F0000000000605A40000036420000C03F"
            "000010C00000003FF90295D0000000000000D03F000000BE00001520030078008100000001000000",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "rtk_fixed", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "undulation": 45.5,
                "course": None,
                "clock_bias": 0.25,
                "clock_drift": -0.125,
                "time_system": "gps",
                "datum": 0,
                "satellites": 21,
                "reference": 3,
                "correction_age": 1.2,
                "signals": 129,
                "latitude": 0.875,
                "longitude": 0.0625,
                "height": 105.5,
                "v_north": 1.5,
                "v_east": -2.25,
                "v_up": 0.5,
            },
        )
    ],
    "PosCovCartesian": [
        (
            "2440F0AA11173800F47C9A17FD0802000000003F0000803E0000403F0000003E000080BD0000003D000080BC0000C03E"
            "F90295D00000203F",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "differential", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "x_x": 0.5,
                "y_y": 0.25,
                "z_z": 0.75,
                "b_b": 0.125,
                "x_y": -0.0625,
                "x_z": 0.03125,
                "x_b": -0.015625,
                "y_z": 0.375,
                "y_b": None,
                "z_b": 0.625,
            },
        )
    ],
    "PosCovGeodetic": [
        (
            "2440302712173800F47C9A17FD0802000000003F0000803E0000403F0000003E000080BD0000003D000080BC0000C03E"
            "F90295D00000203F",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "differential", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "lat_lat": 0.5,
                "lon_lon": 0.25,
                "height_height": 0.75,
                "b_b": 0.125,
                "lat_lon": -0.0625,
                "lat_height": 0.03125,
                "lat_b": -0.015625,
                "lon_height": 0.375,
                "lon_b": None,
                "height_b": 0.625,
            },
        )
    ],
    "VelCovCartesian": [
        (
            "2440705C13173800F47C9A17FD0802000000003F0000803E0000403F0000003E000080BD0000003D000080BC0000C03E"
            "F90295D00000203F",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "differential", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "vx_vx": 0.5,
                "vy_vy": 0.25,
                "vz_vz": 0.75,
                "dt_dt": 0.125,
                "vx_vy": -0.0625,
                "vx_vz": 0.03125,
                "vx_dt": -0.015625,
                "vy_vz": 0.375,
                "vy_dt": None,
                "vz_dt": 0.625,
            },
        )
    ],
    "VelCovGeodetic": [
        (
            "2440912C14173800F47C9A17FD0802000000003F0000803E0000403F0000003E000080BD0000003D000080BC0000C03E"
            "F90295D00000203F",
            {
                "tow": 396000500,
                "week": 2301,
                "mode": {"solution": "differential", "auto_base": 0, "is_2d": 0, "reserved": 0},
                "error": "none",
                "vn_vn": 0.5,
                "ve_ve": 0.25,
                "vu_vu": 0.75,
                "dt_dt": 0.125,
                "vn_ve": -0.0625,
                "vn_vu": 0.03125,
                "vn_dt": -0.015625,
                "ve_vu": 0.375,
                "ve_dt": None,
                "vu_dt": 0.625,
            },
        )
    ],
    "DOP": [
        (
            "24404CC6A10F2000F47C9A17FD08110096004B007D00000000009040F90295D0",
            {
                "tow": 396000500,
                "week": 2301,
                "satellites": 17,
                "pdop": 1.5,
                "tdop": 0.75,
                "hdop": 1.25,
                "vdop": None,
                "hpl": 4.5,
                "vpl": None,
            },
        )
    ],
    "EndOfPVT": [
        (
            "24406B3521171000F47C9A17FD080000",
            {"tow": 396000500, "week": 2301},
        )
    ],
    "EndOfAtt": [
        (
            "2440050937171000F47C9A17FD080000",
            {"tow": 396000500, "week": 2301},
        )
    ],
    "EndOfMeas": [
        (
            "2440F43022171000F47C9A17FD080000",
            {"tow": 396000500, "week": 2301},
        )
    ],
    "BaseVectorCart": [
        (
            "244033DBCB0F4400F47C9A17FD0801340C000401000000000000254000000000004034C0000000000000F83F0000003F"
            "000080BE0000003E876948F40700960021000000",
            {"tow": 396000500, "week": 2301, "count": 1},
        )
    ],
    "BaseVectorGeod": [
        (
            "24406C6FBC0F4400F47C9A17FD0801340C000401000000000000254000000000004034C0000000000000F83F0000003F"
            "000080BE0000003E876948F40700960021000000",
            {"tow": 396000500, "week": 2301, "count": 1},
        )
    ],
    "AttEuler": [
        (
            "24401D3E32172C00F47C9A17FD080F0002000000004087430000A0BFF90295D00000803EF90295D0000000BF",
            {
                "tow": 396000500,
                "week": 2301,
                "satellites": 15,
                "error": {"aux1": "none", "aux2": "none", "not_requested": 0, "reserved": 0},
                "mode": "heading_pitch_fixed",
                "heading": 270.5,
                "pitch": -1.25,
                "roll": None,
                "pitch_rate": 0.25,
                "roll_rate": None,
                "heading_rate": -0.5,
            },
        )
    ],
    "AttCovEuler": [
        (
            "244046CF33172800F47C9A17FD0800040000003F0000803EF90295D0000000BEF90295D0F90295D0",
            {
                "tow": 396000500,
                "week": 2301,
                "error": {"aux1": "none", "aux2": "few_measurements", "not_requested": 0, "reserved": 0},
                "heading_heading": 0.5,
                "pitch_pitch": 0.25,
                "roll_roll": None,
                "heading_pitch": -0.125,
            },
        )
    ],
    "INSNavCart": [
        (
            "2440162481104C00F47C9A17FD08040034121400000000C0FABA4E410000000097BD1241000000D02CC4524196003200"
            "00000A00004087430000A0BF000020400000C03F000010C00000003F",
            {
                "tow": 396000500,
                "week": 2301,
                "gnss_mode": 4,
                "info": 4660,
                "gnss_age": 0.2,
                "accuracy": 1.5,
                "latency": 0.005,
                "datum": 0,
                "parts": ["attitude", "velocity"],
                "attitude": {"heading": 270.5, "pitch": -1.25, "roll": 2.5},
                "position_deviation": None,
                "x": 4027893.5,
                "z": 4919475.25,
                "velocity": {"vx": 1.5, "vy": -2.25, "vz": 0.5},
            },
        )
    ],
    "INSNavGeod": [
        (
            "2440477682105000F47C9A17FD08040034121400000000000000EC3F000000000000B03F0000000000605A4000003642"
            "9600320000000A00004087430000A0BF000020400000C03F000010C00000003F",
            {
                "tow": 396000500,
                "week": 2301,
                "gnss_mode": 4,
                "info": 4660,
                "gnss_age": 0.2,
                "accuracy": 1.5,
                "latency": 0.005,
                "datum": 0,
                "parts": ["attitude", "velocity"],
                "attitude": {"heading": 270.5, "pitch": -1.25, "roll": 2.5},
                "position_deviation": None,
                "latitude": 0.875,
                "height": 105.5,
                "undulation": 45.5,
                "velocity": {"v_east": 1.5, "v_north": -2.25, "v_up": 0.5},
            },
        )
    ],
    "ExtEventINSNavCart": [
        (
            "244016AE85104C00F47C9A17FD08040034121400000000C0FABA4E410000000097BD1241000000D02CC4524196003200"
            "00000A00004087430000A0BF000020400000C03F000010C00000003F",
            {
                "tow": 396000500,
                "week": 2301,
                "gnss_mode": 4,
                "info": 4660,
                "gnss_age": 0.2,
                "accuracy": 1.5,
                "latency": 0.005,
                "datum": 0,
                "parts": ["attitude", "velocity"],
                "attitude": {"heading": 270.5, "pitch": -1.25, "roll": 2.5},
                "position_deviation": None,
                "x": 4027893.5,
                "z": 4919475.25,
                "velocity": {"vx": 1.5, "vy": -2.25, "vz": 0.5},
            },
        )
    ],
    "ExtEventINSNavGeod": [
        (
            "2440D4C386105000F47C9A17FD08040034121400000000000000EC3F000000000000B03F0000000000605A4000003642"
            "9600320000000A00004087430000A0BF000020400000C03F000010C00000003F",
            {
                "tow": 396000500,
                "week": 2301,
                "gnss_mode": 4,
                "info": 4660,
                "gnss_age": 0.2,
                "accuracy": 1.5,
                "latency": 0.005,
                "datum": 0,
                "parts": ["attitude", "velocity"],
                "attitude": {"heading": 270.5, "pitch": -1.25, "roll": 2.5},
                "position_deviation": None,
                "latitude": 0.875,
                "height": 105.5,
                "undulation": 45.5,
                "velocity": {"v_east": 1.5, "v_north": -2.25, "v_up": 0.5},
            },
        )
    ],
    "ExtSensorMeas": [
        (
            "2440BCD8D20F4800F47C9A17FD08021C01020000000000000000E03F000000000000D0BF0000000000A0234001020300"
            "4E0C00000000000000000000000000000000000000000000",
            {"tow": 396000500, "week": 2301, "count": 2},
        )
    ],
    "MeasEpoch": [
        (
            "2440E01EBB0F3400F47C9A17FD0801140C03FE0005200D0578563412C7CFFFFF3075FE8C580205010364A086FF04E803"
            "D007B80B",
            {
                "tow": 396000500,
                "week": 2301,
                "count": 1,
                "common": ["multipath_mitigation", "smoothed"],
                "clock_jumps": 254,
            },
        )
    ],
    "ChannelStatus": [
        (
            "244032C1AD0F2800F47C9A17FD08010C080000000D0000007B4001002D0107000000030002000100",
            {"tow": 396000500, "week": 2301, "count": 1},
        )
    ],
    "QualityInd": [
        (
            "2440AF55F20F1800F47C9A17FD0803000009150A1E0F0000",
            {"tow": 396000500, "week": 2301, "count": 3},
        )
    ],
    "ReceiverStatus": [
        (
            "24405B71AE0F2400F47C9A17FD0822028051010070000000000000000104038E21236402",
            {
                "tow": 396000500,
                "week": 2301,
                "cpu_load": 34,
                "external_error": ["corrections"],
                "uptime": 86400,
                "state": ["week_set", "time_of_week_set", "fine_time"],
                "error": [],
                "count": 1,
                "commands": 3,
                "temperature": 42,
            },
        )
    ],
    "ReceiverTime": [
        (
            "24404F881A171800F47C9A17FD0818020F0D3B2A80070000",
            {
                "tow": 396000500,
                "week": 2301,
                "year": 24,
                "month": 2,
                "day": 15,
                "hour": 13,
                "minute": 59,
                "second": 42,
                "leap_seconds": None,
                "sync": ["week", "time_of_week", "fine_time"],
            },
        )
    ],
    "SatVisibility": [
        (
            "244070D7AC0F2000F47C9A17FD080208050039302E1601022608FFFF6AFFFF01",
            {
                "tow": 396000500,
                "week": 2301,
                "satellites": [
                    {
                        "satellite": 5,
                        "frequency": 0,
                        "azimuth": 123.45,
                        "elevation": 56.78,
                        "course": "rising",
                        "source": "ephemeris",
                    },
                    {
                        "satellite": 38,
                        "frequency": 8,
                        "azimuth": None,
                        "elevation": -1.5,
                        "course": "unknown",
                        "source": "almanac",
                    },
                ],
            },
        )
    ],
    "SatVisibilityLonger": [
        (
            "2440C47AAC2F1C00F47C9A17FD08010C050039302E16010205000000",
            {
                "tow": 396000500,
                "week": 2301,
                "size": 12,
                "satellites": [
                    {
                        "satellite": 5,
                        "frequency": 0,
                        "azimuth": 123.45,
                        "elevation": 56.78,
                        "course": "rising",
                        "source": "ephemeris",
                        "more": b"\x05\x00\x00\x00",
                    }
                ],
            },
        )
    ],
    "InputLink": [
        (
            "244016C4FA0F2400F47C9A17FD0801142140020040E2010078E001008403000083030000",
            {
                "tow": 396000500,
                "week": 2301,
                "links": [
                    {
                        "connection": 33,
                        "type": 64,
                        "age": 2,
                        "bytes_received": 123456,
                        "bytes_accepted": 123000,
                        "messages_received": 900,
                        "messages_accepted": 899,
                    }
                ],
            },
        )
    ],
    "NTRIPClientStatus": [
        (
            "24408BEDD50F1400F47C9A17FD08010401030000",
            {
                "tow": 396000500,
                "week": 2301,
                "clients": [{"connection": 1, "status": "receiving", "error": 0, "info": 0}],
            },
        )
    ],
    "xPPSOffset": [
        (
            "2440608D17171400F47C9A17FD080101000090C0",
            {"tow": 396000500, "week": 2301, "sync_age": 1, "time_scale": "gps", "offset": -4.5},
        )
    ],
    "ExtEvent": [
        (
            "2440267B24372000F47C9A17FD0801000000003E000000000000D0BF01000000",
            {
                "tow": 396000500,
                "week": 2301,
                "pin": 1,
                "polarity": "rising",
                "offset": 0.125,
                "clock_bias": -0.25,
                "position_age": 1,
            },
        )
    ],
    "ExtEventRevision0": [
        (
            "244060CE24171C00F47C9A17FD0801000000003E000000000000D0BF",
            {"revision": 0, "offset": 0.125, "clock_bias": -0.25},
        )
    ],
    "ReceiverSetup": [
        (
            "2440195A0E979401F47C9A17FD08000048494C4C00000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000003700000000000000000000000000000000000000"
            "414200000000000000000000000000000000000041434553000000000000000000000000000000000000000000000000"
            "0000000000000000000000003330303100000000000000000000000000000000342E31302E3100000000000000000000"
            "000000003535000000000000000000000000000000000000534550504F4C414E545F4D4600000000000000000000C03F"
            "0000803E000000BF4E4F4E5F47454F44455449430000000000000000342E31302E310000000000000000000000000000"
            "00000000000000000000000000000000000000006D6F736169632D480000000000000000000000000000000000000000"
            "000000000000000000000000000000000000EC3F000000000000B03F0000F14241424344303042454C00010242454C00"
            "0000000000000000000000000000000000000000",
            {
                "revision": 4,
                "marker": "HILL",
                "offset_north": -0.5,
                "product": "mosaic-H",
                "height": 120.5,
                "country": "BEL",
            },
        )
    ],
    "ReceiverSetupRevision0": [
        (
            "2440D6F70E17F800F47C9A17FD08000048494C4C00000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000003700000000000000000000000000000000000000"
            "414200000000000000000000000000000000000041434553000000000000000000000000000000000000000000000000"
            "0000000000000000000000003330303100000000000000000000000000000000342E31302E3100000000000000000000"
            "000000003535000000000000000000000000000000000000534550504F4C414E545F4D4600000000000000000000C03F"
            "0000803E000000BF",
            {
                "revision": 0,
                "marker": "HILL",
                "firmware": "4.10.1",
                "antenna": "SEPPOLANT_MF",
                "offset_north": -0.5,
            },
        )
    ],
    "BaseVectorCartLonger": [
        (
            "24408F3FCB0F4800F47C9A17FD0801380C000401000000000000254000000000004034C0000000000000F83F0000003F"
            "000080BE0000003E876948F40700960021000000010000A5",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 56},
        )
    ],
    "BaseVectorGeodLonger": [
        (
            "24405076BC0F4800F47C9A17FD0801380C000401000000000000254000000000004034C0000000000000F83F0000003F"
            "000080BE0000003E876948F40700960021000000010000A5",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 56},
        )
    ],
    "InputLinkLonger": [
        (
            "244004E1FA0F2800F47C9A17FD0801182140020040E2010078E001008403000083030000010000A5",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 24},
        )
    ],
    "NTRIPClientStatusLonger": [
        (
            "2440E451D50F1800F47C9A17FD08010801030000010000A5",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 8},
        )
    ],
    "MeasEpochLonger": [
        (
            "2440A98ABB0F3C00F47C9A17FD0801181003FE0005200D0578563412C7CFFFFF3075FE8C58020501010000A50364A086"
            "FF04E803D007B80B0100005A",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 24, "inner_size": 16},
        )
    ],
    "ChannelStatusLonger": [
        (
            "244045FDAD0F3000F47C9A17FD0801100C0000000D0000007B4001002D010700010000A500000300020001000100005A",
            {"tow": 396000500, "week": 2301, "count": 1, "size": 16, "inner_size": 12},
        )
    ],
}
