import os
import re
import socket
import stat
import subprocess
import sys

import pytest

from coulombus.wire.address import (
    AddressError,
    BusAddress,
    BusUnavailable,
    bus_names,
    default_address,
    parse_address,
    socket_path,
)
from places import ROOT


@pytest.fixture
def runtime(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("text", "kind", "name"),
    [
        ("coulombus:bench", "coulombus", "bench"),
        ("coulombus:a.b-c_1", "coulombus", "a.b-c_1"),
        ("socketcan:vcan0", "socketcan", "vcan0"),
        ("socketcan:can-a.1_B", "socketcan", "can-a.1_B"),
        ("can:slcan:/dev/ttyACM0@115200", "can", "slcan:/dev/ttyACM0@115200"),
        ("can:gs_usb", "can", "gs_usb"),
        ("can:socketcand:can0", "can", "socketcand:can0"),
        ("socketcand:127.0.0.1:29536", "socketcand", "127.0.0.1:29536"),
        ("socketcand:[::1]:29536", "socketcand", "[::1]:29536"),
    ],
)
def test_addresses(text, kind, name):
    address = parse_address(text, ("can", "socketcand"))
    assert (address.kind, address.name) == (kind, name)
    assert str(address) == text


def test_an_adapter_has_options_that_are_no_part_of_its_identity():
    address = parse_address("can:slcan:/dev/ttyACM0?bitrate=500000&listen_only=True", ("can",))
    assert address.options == (("bitrate", "500000"), ("listen_only", "True"))
    assert str(address) == "can:slcan:/dev/ttyACM0"
    assert address == parse_address("can:slcan:/dev/ttyACM0", ("can",))
    assert address.is_adapter
    assert address.moves_hardware


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("can:", "expected can:INTERFACE:CHANNEL"),
        ("can::x", "expected can:INTERFACE:CHANNEL"),
        ("can:slcan:x?bitrate", "'bitrate': expected KEY=VALUE"),
        ("can:slcan:x?=5", "'=5': expected KEY=VALUE"),
        ("socketcand:", "expected socketcand:HOST:PORT"),
        ("socketcand:localhost", "expected socketcand:HOST:PORT"),
        ("socketcand:127.0.0.1:65536", "expected socketcand:HOST:PORT"),
        ("slcan:/dev/ttyACM0", "another adapter is can:slcan:/dev/ttyACM0"),
    ],
)
def test_what_is_no_adapter_and_no_server(text, said):
    with pytest.raises(AddressError, match=re.escape(said)) as error:
        parse_address(text, ("can", "socketcand"))
    assert error.value.exit_status == 2


def test_who_needs_a_known_latency_takes_no_adapter_and_says_why():
    with pytest.raises(AddressError, match="a control cycle of 1 ms needs a bus of known latency"):
        parse_address("can:slcan:/dev/ttyACM0")
    with pytest.raises(AddressError, match="coulombus bridge coulombus:bench socketcand:127"):
        parse_address("socketcand:127.0.0.1:29536", ("can",))


@pytest.mark.parametrize(
    ("text", "virtual", "interface", "moves", "packs", "stamped"),
    [
        ("coulombus:bench", True, False, False, True, "when the virtual bus sent the message"),
        ("socketcan:vcan0", False, True, True, False, "when the kernel took the frame"),
    ],
)
def test_what_an_address_says_of_its_bus(text, virtual, interface, moves, packs, stamped):
    address = parse_address(text)
    assert (address.is_virtual, address.is_interface) == (virtual, interface)
    assert (address.moves_hardware, address.packs_frames) == (moves, packs)
    assert address.stamps == f"SO_TIMESTAMPNS: {stamped}"


def test_outside_of_wire_nobody_compares_the_kind_of_a_bus():
    compared = re.compile(r"""[!=]= ?"(coulombus|socketcand?)"|\bin \(?"(coulombus|socketcand?)\"""")
    for top in ("coulombus", "eds", "host", "node", "sim_bus"):
        for path in sorted((ROOT / top).rglob("*.py")):
            if path.parent != ROOT / "coulombus" / "wire":
                assert not compared.search(path.read_text()), path


@pytest.mark.parametrize(
    ("text", "shown", "fix"),
    [
        ("bench", "bench", "coulombus:bench"),
        ("can0", "can0", "socketcan:can0"),
        ("vcan:can0", "vcan:can0", "socketcan:can0"),
        ("", "", "coulombus:bench"),
        ("coulombus:", "", "coulombus:bench"),
        ("coulombus:a/b", "a/b", "coulombus:bench"),
        ("coulombus:../x", "../x", "coulombus:bench"),
        ("coulombus:bench.host", "coulombus:bench.host", ".host"),
        ("socketcan:", "socketcan:", "socketcan:can0"),
        ("socketcan:a_name_too_long0", "socketcan:a_name_too_long0", "1 to 15"),
        ("socketcan:a b", "socketcan:a b", "socketcan:can0"),
        ("socketcan:x;y", "socketcan:x;y", "'_', '-' and '.', not starting with '-' or '.'"),
        ("socketcan:-a", "socketcan:-a", "ip link set NAME name can0"),
        ("socketcan:can-é", "socketcan:can-é", "A-Z"),
    ],
)
def test_what_is_no_address_is_told_with_the_fix(text, shown, fix):
    with pytest.raises(AddressError) as caught:
        parse_address(text)
    assert repr(shown) in str(caught.value)
    assert fix in str(caught.value)
    assert caught.value.exit_status == 2


@pytest.mark.parametrize(("rig", "name"), [("bench", "bench"), ("my rig/2", "my-rig-2"), ("", "bus"), ("x.host", "x")])
def test_default_address_is_an_address(rig, name):
    assert default_address(rig) == BusAddress("coulombus", name)
    assert parse_address(str(default_address(rig))) == default_address(rig)


def test_socket_stands_in_a_private_directory(runtime):
    path = socket_path("bench")
    assert path == runtime / "coulombus" / "bench"
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_without_a_runtime_directory_of_ours_a_private_temporary_one(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for runtime in (None, "", "relative", str(tmp_path / "absent")):
        if runtime is None:
            monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        else:
            monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
        assert socket_path("bench") == tmp_path / f"coulombus-{os.geteuid()}" / "bench"


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o277])
def test_the_directory_is_private_whatever_the_umask(runtime, umask):
    before = os.umask(umask)
    try:
        path = socket_path("bench")
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o755, 0o710, 0o701])
def test_a_directory_that_others_may_enter_is_refused_with_what_mends_it(runtime, mode):
    (runtime / "coulombus").mkdir()
    (runtime / "coulombus").chmod(mode)
    text = f"{runtime / 'coulombus'} has mode {mode:04o}, expected 0700: chmod 700 {runtime / 'coulombus'};"
    with pytest.raises(BusUnavailable) as caught:
        socket_path("bench")
    assert text in str(caught.value)
    (runtime / "coulombus").chmod(0o700)
    assert socket_path("bench") == runtime / "coulombus" / "bench"


@pytest.mark.skipif(os.getuid() != 0, reason="only root gives a folder away")
def test_a_directory_of_another_user_is_refused(runtime):
    (runtime / "coulombus").mkdir(mode=0o700)
    os.chown(runtime / "coulombus", 65534, 65534)
    with pytest.raises(BusUnavailable, match=r"belongs to user 65534, and not to user 0"):
        socket_path("bench")


def test_a_link_or_a_file_in_the_directorys_place_is_refused(runtime):
    (runtime / "elsewhere").mkdir(mode=0o700)
    (runtime / "coulombus").symlink_to(runtime / "elsewhere")
    with pytest.raises(BusUnavailable):
        socket_path("bench")
    (runtime / "coulombus").unlink()
    (runtime / "coulombus").write_text("")
    with pytest.raises(BusUnavailable) as caught:
        socket_path("bench")
    assert caught.value.exit_status == 4


def test_a_path_too_long_for_a_socket_is_told(runtime):
    longest = 107 - len(str(runtime / "coulombus")) - 1
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    client.bind(str(socket_path("n" * longest)))
    client.close()
    with pytest.raises(AddressError, match="1 bytes longer"):
        socket_path("n" * (longest + 1))


def test_names_of_the_buses_that_are_there(runtime):
    assert bus_names() == []
    made = []
    for name in ("b", "a", "a.host"):
        made.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        made[-1].bind(str(socket_path(name)))
    (runtime / "coulombus" / "a.txt").write_text("")
    assert bus_names() == ["a", "b"]
    for place in made:
        place.close()


def test_clients_start_without_numba():
    code = (
        "import sys, coulombus.wire.address, coulombus.wire.handshake, coulombus.wire.client\n"
        "import coulombus.wire.can_interface, coulombus.recording.can_io\n"
        "sys.exit(', '.join({'numba', 'scipy', 'pydantic', 'canopen'} & set(sys.modules)) or 0)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
