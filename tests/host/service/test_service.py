"""`coulombus systemd`: the units, what systemd itself says of them, and signs of life of a host."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import time

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.service.units import UnitSettings, files
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.rigs.rig import load_rig, packaged_rig
from real_bench import children, host, result, simulation
from systemd_syntax import systemd_words

ANALYZE = shutil.which("systemd-analyze")
EXPOSURE = 2.0


def service(**more):
    known = {"program": ("/bin/true",), "rig": "bench", "bus": "socketcan:can0", "mode": "hybrid"}
    return UnitSettings(**(known | {"bitrate_bit_s": 500_000, "ending_s": 7.0} | more))


def typed(install):
    """Return the commands of an INSTALL.txt."""
    return [line.strip().partition("  #")[0] for line in install.splitlines() if line.startswith("    ")]


def values(unit, key):
    return re.findall(rf"^{key}=(.*)$", unit, re.M)


@pytest.mark.parametrize("user", [False, True])
@pytest.mark.parametrize("bus", ["socketcan:can0", "coulombus:bench"])
@pytest.mark.skipif(ANALYZE is None, reason="no systemd-analyze")
def test_systemd_takes_the_units_as_they_are(tmp_path, user, bus):
    made = files(service(user=user, bus=bus, rig="/my rigs/50 % $x.toml"))
    units = [name for name in made if name.endswith(".service")]
    for name in units:
        (tmp_path / name).write_text(made[name])
    scope = ["--user"] if user else []
    options = {"capture_output": True, "text": True, "env": {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}}
    done = subprocess.run([ANALYZE, *scope, "verify", *(tmp_path / name for name in units)], **options, check=False)
    said = done.stdout + done.stderr
    if "Failed to initialize manager" in said:
        pytest.skip("systemd-analyze verifies nothing here")
    assert done.returncode == 0, said
    assert "coulombus-" not in said, said
    if not user:
        for name in units:
            words = [ANALYZE, "security", "--offline=yes", str(tmp_path / name)]
            told = subprocess.run(words, **options, check=False).stdout
            level = re.search(r"exposure level for \S+: ([\d.]+)", told)
            assert level is None or float(level[1]) <= EXPOSURE, told


def test_the_host_is_never_started_again_and_never_enabled():
    """After a trip nothing re-arms by itself."""
    for user in (False, True):
        made = files(service(user=user))
        unit = made["coulombus-host.service"]
        assert values(unit, "Restart") == ["no"]
        assert "[Install]" not in unit
        assert values(unit, "Type") == ["notify"]
        assert values(unit, "TimeoutStopSec") == ["37"]
        assert "143" in values(unit, "SuccessExitStatus")[0].split()
        assert values(unit, "KillMode") == ["control-group"]
        for name in ("coulombus-sim.service", "coulombus-bridge.service"):
            assert values(made[name], "Restart") == ["on-failure"]
            assert "[Install]" in made[name]


def test_what_the_data_plane_needs_is_not_taken_away():
    unit = files(service())["coulombus-host.service"]
    assert values(unit, "LimitRTPRIO") == ["95"]
    assert values(unit, "LimitMEMLOCK") == ["infinity"]
    assert values(unit, "DeviceAllow") == ["/dev/cpu_dma_latency rw", "char-gpiochip r"]
    assert "AF_CAN" in values(unit, "RestrictAddressFamilies")[0]
    for key in ("MemoryDenyWriteExecute", "RestrictRealtime", "PrivateDevices", "PrivateNetwork"):
        assert not values(unit, key)


def test_the_interface_is_the_hosts_with_the_rigs_bit_rate():
    made = files(service(bus="socketcan:can-a1"))
    assert values(made["80-coulombus-can-a1.network"], "BitRate") == ["500000"]
    assert "bitrate 500000" in made["can-a1-up.sh"]
    assert values(made["coulombus-host.service"], "BindsTo") == [r"sys-subsystem-net-devices-can\x2da1.device"]
    assert subprocess.run(["sh", "-n"], input=made["can-a1-up.sh"], text=True, check=False).returncode == 0


HOSTILE = (
    "x;touch$IFS..P",
    "x;y",
    "$(touch P)",
    "`id`",
    "a%n",
    "can*",
    "[a]",
    "!can0",
    "-x",
    ".x",
    "a'b",
    'a"b',
    "a\\b",
)


@pytest.mark.parametrize("name", [*HOSTILE, "x\x1b]52;c;", "x\u202e"])
def test_a_bus_whose_name_another_program_would_read_is_refused_and_nothing_written(tmp_path, name):
    for more in ((), ("--user",)):
        words = ["systemd", "--bus", f"socketcan:{name}", "-o", str(tmp_path / "u"), *more]
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 2
        assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="network interface"):
        files(service(bus=f"socketcan:{name}"))


@pytest.mark.parametrize("name", ["can0", "can-a.1", "a" * 15, "0", "_"])
def test_the_threads_of_this_interface_alone_are_raised(name):
    made = files(service(bus=f"socketcan:{name}"))
    _, _, script = systemd_words(values(made["coulombus-host.service"], "ExecStartPre")[0].removeprefix("+-"))
    for text in (script, made[f"{name}-up.sh"]):
        pattern = shlex.split(re.search(r"\$\(pgrep (.*?)\);", text)[1])[0]
        told = subprocess.run(
            ["grep", "-E", pattern], input=f"irq/45-{name}\nirq/45-{name}x\nirq/4-x\n", capture_output=True, text=True
        )
        assert told.stdout == f"irq/45-{name}\n"
        assert subprocess.run(["sh", "-n"], input=text, text=True, check=False).returncode == 0


def test_the_rigs_path_and_the_program_come_to_the_host_as_they_are(tmp_path):
    rig = tmp_path / "my $x %n; rig's\t.toml"
    program = tmp_path / "50 % $HOME" / "coulombus"
    made = files(service(rig=str(rig), program=(str(program),)))
    words = systemd_words(values(made["coulombus-host.service"], "ExecStart")[0])
    assert words[:4] == [str(program), "run", "--rig", str(rig)]


def test_no_file_is_replaced_and_then_none_is_written(tmp_path):
    def call(*more):
        return CliRunner().invoke(main, ["systemd", "-o", str(tmp_path / "units"), *more])

    (tmp_path / "units").mkdir()
    mine = tmp_path / "units" / "coulombus-sim.service"
    mine.write_text("mine")
    assert call().exit_code == 2
    assert [path.name for path in (tmp_path / "units").iterdir()] == [mine.name]
    assert mine.read_text() == "mine"
    assert call("--force").exit_code == 0
    assert "ExecStart" in mine.read_text()
    assert len(list((tmp_path / "units").glob("*.service"))) == 2


def test_a_rig_on_several_buses_is_refused(tmp_path):
    """Its buses are coupled by the process that starts them, of which a unit knows nothing."""
    rig = tmp_path / "two.toml"
    rig.write_text(load_rig("two_axes", ["axis.left.bus.channel=a", "axis.right.bus.channel=b"]).effective())
    done = CliRunner().invoke(main, ["systemd", "--rig", str(rig), "-o", str(tmp_path / "u")])
    assert done.exit_code == 2
    assert "the buses a, b" in " ".join(done.output.replace("│", " ").split())
    assert not (tmp_path / "u").exists()


def test_a_folder_that_cannot_be_made_is_a_usage_error():
    assert CliRunner().invoke(main, ["systemd", "-o", "/dev/null/x"]).exit_code == 2


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.usefixtures("private_sockets")
@pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop")
def test_a_host_gives_signs_of_life_while_its_cycle_goes_on(tmp_path):
    """A data plane that stands still leaves a parent that runs, and no sign of life."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(tmp_path / "notify"))
        ear.settimeout(60)
        given = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"}
        with simulation("coulombus:n"), host("coulombus:n", env=given) as run:
            assert ear.recv(4096).decode().startswith("READY=1\n"), result(run)
            assert ear.recv(4096) == b"WATCHDOG=1"
            assert ear.recv(4096) == b"WATCHDOG=1"
            (plane,) = children(run.pid)
            os.kill(plane, signal.SIGSTOP)
            ear.setblocking(False)
            begin, late = time.monotonic(), []
            while run.poll() is None and time.monotonic() < begin + 60:
                try:
                    late.append((time.monotonic() - begin, ear.recv(4096)))
                except BlockingIOError:
                    time.sleep(0.01)
            status, data, err = result(run)
            assert status == 7, err
            assert data["trip"].endswith("(it is stopped, as by SIGSTOP)")
        assert not [t for t, message in late if message == b"WATCHDOG=1" and t > 0.5]
        assert any(message.startswith(b"STOPPING=1") for _, message in late)


@pytest.mark.parametrize("user", [False, True])
@pytest.mark.parametrize("bus", ["socketcan:can0", "coulombus:bench"])
def test_the_programs_of_install_txt_are_found_under_a_bare_path(tmp_path, user, bus):
    """sudo's PATH has no virtual environment: what is typed has the program's path, quoted where it must be."""
    program = tmp_path / "an environment" / "coulombus"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\necho found $*\n")
    program.chmod(0o755)
    lines = typed(files(service(user=user, bus=bus, program=(str(program),)))["INSTALL.txt"])
    ours = [line.removeprefix("sudo -u coulombus ") for line in lines if "environment/coulombus" in line]
    assert len(ours) == 1
    done = subprocess.run(["/bin/sh", "-c", ours[0]], env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "found doctor\n" if user else "found stop\n"), done.stderr


@pytest.mark.parametrize("user", [False, True])
def test_what_is_copied_is_there_and_a_virtual_bus_has_no_files_of_an_interface(user):
    interface = {"coulombus-bridge.service"} | (set() if user else {
        "90-coulombus.rules", "80-coulombus-can0.network", "80-coulombus-can0.link", "can0-up.sh",
    })  # fmt: skip
    made = {
        kind: files(service(user=user, **more))
        for kind, more in (
            ("interface", {}), ("virtual", {"bus": "coulombus:bench"}), ("bridge", {"bus": "coulombus:bench", "bridge": True}),
        )
    }  # fmt: skip
    assert set(made["interface"]) == set(made["bridge"])
    assert set(made["bridge"]) - set(made["virtual"]) == interface
    for kind in made.values():
        copied = re.findall(r"(?<=cp )[\w.-]+\.\w+|(?<=sh )[\w.-]+\.sh|80-\S+\.link", kind["INSTALL.txt"])
        assert set(copied) <= set(kind)
        assert set(kind) - set(copied) <= {name for name in kind if name.endswith(".service")} | {"INSTALL.txt"}


def test_a_rig_that_run_would_refuse_gets_no_units(tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(packaged_rig("bench").read_text() + "\n# REHEARSAL\n")
    last = len(rig.read_text().splitlines())
    units = tmp_path / "units"
    done = CliRunner().invoke(main, ["systemd", "--rig", str(rig), "--bus", "socketcan:can0", "-o", str(units)])
    assert done.exit_code == 3
    assert f"rig.toml:{last}: still marked '# REHEARSAL'" in " ".join(done.output.split())
    assert not units.exists()
    assert CliRunner().invoke(main, ["systemd", "--rig", str(rig), "-o", str(units)]).exit_code == 0
