import io
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time

import pytest
from rich.console import Console

from coulombus.monitor.watch import watch
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig
from coulombus.wire.address import parse_address
from tiny_bus import tiny_bus

pytestmark = [pytest.mark.real_time, pytest.mark.patient]

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
BENCH = parse_address("coulombus:bench")
COMMAND = [sys.executable, "-c", "import sys; from coulombus.cli.main import main; sys.exit(main())", "watch"]


@pytest.fixture(autouse=True)
def runtime(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", ROOT)


def cycle(bus, n):
    bus.deliver((0x80, b""), (0x181, struct.pack("<Hih", 0x0237, 100 * n, 0)))


class Traffic:
    """A SYNC and a TPDO each millisecond or so, until the end."""

    def __init__(self, bus):
        self._bus, self._stop = bus, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5)

    def _run(self):
        n = 0
        while not self._stop.wait(0.001):
            cycle(self._bus, n)
            n += 1


def started(*arguments, **options):
    return subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGQUIT])
def test_signals_end_it_well_also_when_they_were_ignored(number):
    def ignore():
        signal.signal(number, signal.SIG_IGN)

    with tiny_bus() as bus, Traffic(bus), started("--json", "--interval", "0.05", preexec_fn=ignore) as process:
        first = json.loads(process.stdout.readline())
        assert first["bus"] == "coulombus:bench"
        while json.loads(process.stdout.readline())["sync_per_s"] == 0:
            pass
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
        assert (process.returncode, err) == (0, "")
        last = json.loads(out.splitlines()[-1])
        assert last["signals"]["motor.statusword"] == 0x0237
        assert last["pdos"]["motor.TPDO1"]["rate_per_s"] > 0
        assert last["lost"] == 0
        assert bus.frames == []  # nothing was sent
        assert bus.greetings[0][0] == 6  # listens only, wants error frames


def test_a_bus_that_goes_away_ends_it_with_4():
    with tiny_bus() as bus, started("--interval", "0.05") as process:
        while "frames/s" not in process.stdout.readline():
            pass
        cycle(bus, 1)
        bus.close()
        _, err = process.communicate(timeout=60)
    assert process.returncode == 4
    assert err.startswith("coulombus: bus coulombus:bench is gone")
    assert "Traceback" not in err


@pytest.mark.thorough
def test_no_bus_and_no_address():
    for arguments, status, text in (
        ((), 4, "`coulombus emulate --rig bench`"),
        (("--rig", "two_axes"), 4, "`coulombus emulate --rig two_axes`"),
        (("--bus", "can0"), 2, "socketcan:can0"),
        (("--bus", "socketcan:nocan0"), 4, "socketcan:nocan0"),
    ):
        with started(*arguments) as process:
            out, err = process.communicate(timeout=60)
        assert (process.returncode, out) == (status, "")
        assert text in err


def test_a_reader_that_goes_away_ends_it_quietly():
    with tiny_bus() as bus, Traffic(bus), started("--json", "--interval", "0.02") as process:
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(20) == 0
        assert process.stderr.read() == ""


def test_table_in_a_terminal():
    before = signal.getsignal(signal.SIGTERM)
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120, height=50, color_system=None)
    with tiny_bus() as bus, Traffic(bus):
        bus.lost = 3
        watch(KnownBus(load_rig("bench")), BENCH, seconds=0.5, console=console)
    last = screen.getvalue().split("coulombus:bench")[-1]
    assert "operation enabled" in last
    assert "position_rad" in last
    assert "not heard" in last
    assert signal.getsignal(signal.SIGTERM) is before


def test_lost_frames_are_shown():
    with tiny_bus() as bus:
        bus.lost = 3
        with started("--json", "--interval", "0.1", "--seconds", "5") as process:
            deadline = time.monotonic() + 10
            while json.loads(process.stdout.readline())["lost"] != 3:
                assert time.monotonic() < deadline
            process.terminate()
            process.communicate(timeout=60)
            assert process.returncode == 0
