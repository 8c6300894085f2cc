"""What computes a CRC does not change it."""

from __future__ import annotations

import random

import anycrc
import pytest

from aces_bus.protocol import Crc

PARAMETERS = ("width", "poly", "init", "refin", "refout", "xorout")


def test_a_crc_by_its_name_is_that_by_its_parameters() -> None:
    """By name the package `fastcrc` computes it where it can, by parameters `anycrc`; of no bytes, few and many."""
    for name, model in anycrc.models.items():
        by_name, by_parameters = Crc(name), Crc(**{one: getattr(model, one) for one in PARAMETERS})
        draw = random.Random(name)
        for size in (0, 1, 2, 8, 35, 300, 5000):
            data = draw.randbytes(size)
            assert by_name.compute(data) == by_parameters.compute(data), name
            assert by_name.engine(data) == by_parameters.engine(data), name


def test_fastcrc_is_used_where_it_is_installed() -> None:
    """The functions of MAVLink's, Modbus's and Dynamixel's CRC are found under its names."""
    crc16 = pytest.importorskip("fastcrc.crc16")
    names = {"CRC16-MCRF4XX": "mcrf4xx", "CRC16-MODBUS": "modbus", "CRC16-UMTS": "umts"}
    for name, function in names.items():
        assert Crc(name).engine is getattr(crc16, function)
