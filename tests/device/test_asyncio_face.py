"""Devices and clients in programs of asyncio: what is awaited lets other tasks run, raises, and ends with the program."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import aclosing

import can
import pytest
import serial

from aces_bus import as_dict, load_robot
from aces_bus.device import Client, Job, Steps
from aces_bus.errors import DeviceError, NoReplyError
from aces_bus.robot import VirtualRobot, run_real
from aces_bus.runtime.loop import Loop
from aces_tools.sim import SimulatedRobot
from tests.device.test_client import lamp, line
from tests.tools.test_stop import arm as arm
from tests.tools.test_stop import stand as stand

PATIENCE_S = 30.0


@pytest.fixture
def loop() -> Iterator[Loop]:
    with Loop() as made:
        yield made


def test_a_ticket_is_awaited_in_virtual_time() -> None:
    """Its time passes at once; the record is the result, a missing answer is raised."""

    async def program() -> str:
        with VirtualRobot(load_robot("hubo2plus").part("RKN")) as robot:
            board = robot.rig.device("RKN")
            record = await board.ask("SendStatus", reply="Status")
            robot.simulation[board.name].fault("silent")
            with pytest.raises(NoReplyError):
                await board.ask("SendStatus", reply="Status")
            return type(record).__name__

    assert asyncio.run(program()) == "Status"


def test_a_job_is_awaited_while_other_tasks_run(loop: Loop) -> None:
    """The loop of the buses goes on in its own thread; results and errors come out where it is awaited."""
    ticks: list[int] = []

    def steps(job: Job) -> Steps:
        yield 50_000_000
        return threading.get_ident()

    def fails(job: Job) -> Steps:
        yield 1_000_000
        raise DeviceError("it is off")

    async def program() -> None:
        async def tick() -> None:
            while True:
                ticks.append(len(ticks))
                await asyncio.sleep(0.005)

        other = asyncio.create_task(tick())
        assert await Job(loop, "fan enable", steps) == loop.own_thread
        with pytest.raises(DeviceError, match="it is off"):
            await Job(loop, "fan enable", fails)
        over = Job(loop, "fan enable", steps)
        over.wait()
        assert await over == loop.own_thread
        other.cancel()

    asyncio.run(program())
    assert len(ticks) > 2


def test_a_wait_can_be_given_up(loop: Loop) -> None:
    """`asyncio.timeout` ends the wait and not the job, whose end then reaches nobody."""

    def steps(job: Job) -> Steps:
        yield 30_000_000

    async def program() -> Job:
        job = Job(loop, "fan enable", steps)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.001):
                await job
        return job

    job = asyncio.run(program())  # the program's loop is closed before the job is over
    assert loop.wait(lambda: job.is_over, round(PATIENCE_S * 1e9))
    assert not loop.failures


def test_a_loop_says_where_it_runs(loop: Loop) -> None:
    """Elsewhere for other threads, as long as it runs."""
    assert loop.is_elsewhere
    assert not loop.call(lambda: loop.is_elsewhere)
    assert not Loop().is_elsewhere
    loop.stop()
    assert not loop.is_elsewhere


@pytest.mark.slow
def test_a_device_on_a_bus_is_asked(arm: str, stand: SimulatedRobot) -> None:
    """From asyncio's thread, while the buses' thread runs; several at once, each with its own answer."""
    buses = {"legs": {"interface": "aces", "channel": "unix:arm0"}}

    async def program() -> list[object]:
        with run_real(stand.robot, [], buses=buses, passive=False) as run:
            boards = [run.rig.devices["JMC0"], run.rig.devices["JMC1"]]
            asked = (board.ask("SendStatus", reply="Status", timeout_s=5.0) for board in boards)
            return [as_dict(await ticket)["board"] for ticket in list(asked)]

    assert asyncio.run(program()) == [0, 1]


def test_records_are_iterated_over() -> None:
    """As they come, kept ones first; the bus is free again when the iteration is closed."""
    ours, theirs = (can.Bus("asyncio-face", interface="virtual") for _ in range(2))
    client = Client(ours, lamp)

    def send(count: int) -> None:
        theirs.send(can.Message(arbitration_id=0x303, data=[count], is_extended_id=False))

    async def program() -> list[object]:
        found: list[object] = []
        send(0)
        async with aclosing(aiter(client)) as records:
            async for record in records:
                found.append(as_dict(record)["count"])
                if len(found) == 4:
                    break
                send(len(found))
        send(99)
        (late,) = client.listen(0.05)
        found.append(as_dict(late)["count"])
        return found

    try:
        assert asyncio.run(program()) == [0, 1, 2, 3, 99]
        assert not [t for t in threading.enumerate() if t.name == "records"]
    finally:
        ours.shutdown()
        theirs.shutdown()


def test_a_program_that_falls_behind_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread waits; all that was sent is there, in order."""
    monkeypatch.setattr("aces_bus.device.asyncio_face.MOST_WAITING", 2)
    ours, theirs = (can.Bus("asyncio-late", interface="virtual") for _ in range(2))

    async def program() -> list[object]:
        found: list[object] = []
        async for record in Client(ours, lamp):
            time.sleep(0.002)  # it blocks its loop
            found.append(as_dict(record)["count"])
            if len(found) == 50:
                break
        return found

    try:
        for count in range(50):
            theirs.send(can.Message(arbitration_id=0x303, data=[count], is_extended_id=False))
        assert asyncio.run(program()) == list(range(50))
    finally:
        ours.shutdown()
        theirs.shutdown()


def test_a_bus_that_fails_raises_where_it_is_iterated() -> None:
    """Once, and the thread ends."""
    port = serial.serial_for_url("loop://")

    async def program() -> None:
        async for _ in Client(port, line):
            raise AssertionError("nothing was sent")

    port.close()
    with pytest.raises(serial.PortNotOpenError):
        asyncio.run(program())
    assert not [t for t in threading.enumerate() if t.name == "records"]
