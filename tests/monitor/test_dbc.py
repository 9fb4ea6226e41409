import struct
import subprocess
import sys
from decimal import Decimal

import cantools
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.monitor.dbc import database_text
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import load_rig
from host_bench import VELOCITY


@pytest.fixture(params=["bench", "paper"])
def rig(request):
    return load_rig(request.param)


def read(text):
    return cantools.database.load_string(text, "dbc", strict=True)


def test_scales_units_and_signs_are_the_rigs_bit_for_bit(rig):
    database = read(database_text(KnownBus(rig)))
    for pdo in rig.pdos():
        message = database.get_message_by_frame_id(pdo.layout.cob_id)
        assert message.length == pdo.layout.length
        assert message.senders == (["host"] if pdo.layout.direction == "rpdo" else [pdo.node])
        for signal, entry, start in zip(pdo.signals, pdo.layout.entries, pdo.layout.starts, strict=True):
            field = message.get_signal_by_name(signal.name.partition(".")[2])
            assert (field.start, field.length, field.is_signed) == (start, entry.bits, entry.signed)
            assert (field.scale, field.offset, field.unit or "") == (signal.scale, signal.offset, signal.unit)
            assert field.byte_order == "little_endian"


def test_a_frame_decoded_by_cantools():
    rig = load_rig("bench")
    database = read(database_text(KnownBus(rig)))
    data = struct.pack("<Hih", 0x1237, -819200, -250)
    values = database.decode_message("motor_TPDO1", data)
    assert values["statusword"] == 0x1237
    assert values["position_rad"] == pytest.approx(-100 * 2 * 3.141592653589793 / 9.587)
    assert values["torque_Nm"] == pytest.approx(-0.25 * 0.180 * 9.587)
    assert database.get_message_by_name("motor_TPDO1").get_signal_by_name("torque_Nm").unit == "Nm"


def test_services_are_decoded_too():
    database = read(database_text(KnownBus(load_rig("bench"))))
    assert database.decode_message(0x701, b"\x05")["state"] == "operational"
    assert database.decode_message(0x000, b"\x80\x00") == {"command": "enter_pre_operational", "node": "all"}
    assert database.decode_message(0x082, bytes.fromhex("5082 11 0000000000"))["code"] == "RPDO time-out"
    assert database.get_message_by_name("motor_heartbeat").cycle_time == 50
    assert database.get_message_by_name("SYNC").length == 0


@pytest.mark.thorough
def test_command_writes_the_file_and_cantools_decodes_with_it(tmp_path):
    path = tmp_path / "bench.dbc"
    sets = [word for text in VELOCITY for word in ("--set", text)]
    assert CliRunner().invoke(main, ["dbc", "-o", str(path), *sets]).exit_code == 0
    assert CliRunner().invoke(main, ["dbc", *sets]).output == path.read_text()
    log = "(0.0) can0 281#0010000000000000\n(0.001) can0 281#00100000\n"
    done = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(path)],
        input=log,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "motor_TPDO2(velocity_rad_s: " in done.stdout
    value = Decimal(done.stdout.splitlines()[-1].split("velocity_rad_s: ")[1].split(" rad/s")[0])
    assert float(value) == pytest.approx(4096 / 8192 * 2 * 3.141592653589793 / 9.587)


def test_command_refuses_an_output_directory_that_is_not_there(tmp_path):
    result = CliRunner().invoke(main, ["dbc", "-o", str(tmp_path / "absent" / "x.dbc")])
    assert result.exit_code == 2
    assert "absent" in result.output
