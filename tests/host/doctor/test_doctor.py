"""`coulombus doctor`: checks on fake trees of /sys and /proc, and the latency test's judgement."""

from __future__ import annotations

import json
import random
import shlex
import subprocess
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.host.doctor import software
from coulombus.host.doctor.checks import Absent, CannotRead, Machine, Outcome, examine, script
from coulombus.host.doctor.cpu import others_mask
from coulombus.host.doctor.examination import RigDemands, examination, free
from coulombus.host.doctor.latency import (
    Latency,
    LatencyError,
    Wakeups,
    bars,
    judge,
    measure_latency,
    read_cyclictest,
)
from coulombus.kernels import decorator
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.rigs.rig import load_rig
from coulombus.system.realtime import bus_cpu, cpu_list, default_cpu
from coulombus.wire.address import parse_address
from places import ROOT

CAN0 = {"": parse_address("socketcan:can0")}
WANTED = RigDemands.from_rig(load_rig("bench"))
CPUS = "sys/devices/system/cpu"
LIMITS = "Limit  Soft  Hard  Units\nMax locked memory         {memlock} {memlock} bytes\nMax realtime priority     {rtprio} {rtprio}\n"


def stat(rt_priority):
    """/proc/PID/stat of a thread whose name has a blank and a bracket (proc(5))."""
    head = "210 (irq/24-can0 x) S 2 0 0 0 -1 2129984 0 0 0 0 0 0 0 0"
    return f"{head} -91 0 1 0 85 0 0 18446744073709551615 0 0 0 0 0 0 0 2147483647 0 0 0 0 17 3 {rt_priority} 1 0 0 0"


GOOD = {
    "proc/version": "Linux version 6.1.0-18-rt-amd64 (x@y) #1 SMP PREEMPT_RT Debian 6.1.76-1",
    "sys/kernel/realtime": "1",
    "etc/os-release": 'PRETTY_NAME="Debian"\nID=debian\n',
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "tsc",
    "sys/devices/system/clocksource/clocksource0/available_clocksource": "tsc hpet acpi_pm",
    "proc/sys/kernel/sched_rt_runtime_us": "950000",
    "proc/sys/kernel/sched_rt_period_us": "1000000",
    "proc/swaps": "Filename\t\t\t\tType\t\tSize\t\tUsed\t\tPriority",
    "proc/cpuinfo": "processor\t: 0\nflags\t\t: fpu tsc\nprocessor\t: 1\nflags\t\t: fpu tsc\n",
    f"{CPUS}/online": "0-3",
    f"{CPUS}/isolated": "3",
    f"{CPUS}/nohz_full": "3",
    f"{CPUS}/cpu3/cpufreq/scaling_governor": "performance",
    f"{CPUS}/cpu0/cpuidle/state0/name": "POLL",
    f"{CPUS}/cpu0/cpuidle/state0/latency": "0",
    f"{CPUS}/cpu0/cpuidle/state1/name": "C6",
    f"{CPUS}/cpu0/cpuidle/state1/latency": "133",
    "proc/irq/24/can0/x": "",
    "proc/irq/24/smp_affinity_list": "3",
    "proc/irq/25/eth0/x": "",
    "proc/210/comm": "irq/24-can0",
    "proc/210/stat": stat(90),
    "proc/211/comm": "irq/25-eth0",
    "proc/211/stat": stat(50),
    "proc/212/comm": "python",
    "proc/irq/25/effective_affinity_list": "0-2",
    "proc/irq/26/smp_affinity_list": "0-3",  # has no handler
    "proc/self/limits": LIMITS.format(memlock="unlimited", rtprio="95"),
    "proc/self/status": "Name:\tpython\nUid:\t1000\t1000\t1000\t1000\nCapEff:\t0000000000000000\n",
    "dev/cpu_dma_latency": "",
    "sys/class/net/can0/type": "280",
    "sys/class/net/can0/flags": "0x40081",
    "sys/class/net/can0/tx_queue_len": "64",
    "sys/devices/pci0/usb1/1-2/power/control": "on",
    "sys/devices/pci0/usb1/1-2/1-2:1.0/x": "",
    "sys/drivers/gs_usb/x": "",
}
LINK = {
    "ifname": "can0",
    "linkinfo": {
        "info_kind": "can",
        "info_data": {
            "ctrlmode": ["BERR-REPORTING"],
            "state": "ERROR-ACTIVE",
            "berr_counter": {"tx": 0, "rx": 0},
            "restart_ms": 100,
            "bittiming": {"bitrate": 1000000, "sample_point": "0.875"},
        },
        "info_xstats": {"bus_error": 0, "error_passive": 0, "bus_off": 0},
    },
}
BAD = {
    "proc/version": "Linux version 6.1.0-18-amd64 (x@y) #1 SMP PREEMPT_DYNAMIC Debian",
    "sys/kernel/realtime": None,
    "sys/devices/system/clocksource/clocksource0/current_clocksource": "hpet",
    "proc/sys/kernel/sched_rt_runtime_us": "500000",
    "proc/swaps": GOOD["proc/swaps"] + "\n/dev/sda2  partition 999 0 -2",
    "proc/cpuinfo": "processor\t: 0\nflags\t\t: fpu hypervisor\n",
    f"{CPUS}/isolated": "",
    f"{CPUS}/nohz_full": "(null)",
    f"{CPUS}/cpu3/cpufreq/scaling_governor": "powersave",
    "proc/irq/25/effective_affinity_list": "3",
    "proc/self/limits": LIMITS.format(memlock="8388608", rtprio="0"),
    "dev/cpu_dma_latency": None,
    "proc/210/stat": stat(50),
    "sys/class/net/can0/flags": "0x40080",
    "sys/class/net/can0/tx_queue_len": "10",
    "sys/devices/pci0/usb1/1-2/power/control": "auto",
}
BAD_LINK = {
    "state": "ERROR-PASSIVE",
    "ctrlmode": ["LISTEN-ONLY"],
    "berr_counter": {"tx": 128, "rx": 0},
    "restart_ms": 0,
    "bittiming": {"bitrate": 500000, "sample_point": "0.750"},
}


def link_with(**info):
    told = json.loads(json.dumps(LINK))
    told["linkinfo"]["info_data"] |= info
    return told


@pytest.fixture
def machine(tmp_path):
    """Return a function that makes a machine: the good one, with some files otherwise or
    missing.
    """

    def make(files=None, link=LINK, base=GOOD):
        for name, text in (base | (files or {})).items():
            if text is not None:
                path = tmp_path / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(text if isinstance(text, bytes) else text.encode())
        net = tmp_path / "sys/class/net/can0"
        if net.is_dir() and "sys/devices/pci0/usb1/1-2/1-2:1.0/x" in base:
            (net / "device").unlink(missing_ok=True)
            (tmp_path / "sys/devices/pci0/usb1/1-2/1-2:1.0/driver").unlink(missing_ok=True)
            (net / "device").symlink_to("../../../devices/pci0/usb1/1-2/1-2:1.0")
            (tmp_path / "sys/devices/pci0/usb1/1-2/1-2:1.0/driver").symlink_to("../../../../../drivers/gs_usb")

        def ask(words):
            assert words[0] == "ip"
            if link is None:
                raise Absent("ip is not installed")
            return link if isinstance(link, str) else json.dumps([link])

        return Machine(tmp_path, ask, lambda name: True)

    return make


@pytest.fixture
def examined(machine, tmp_path):
    """Return a function that examines such a machine: findings by the checks' names."""

    def run(files=None, link=LINK, base=GOOD, addresses=CAN0):
        found = examination(WANTED, addresses, machine=machine(files, link, base), given_cpu=3, folder=tmp_path)
        return {one.check: one for one in found if not one.check.startswith(("software", "disk"))}

    return run


def test_a_good_machine_has_nothing_to_mend(examined):
    found = examined()
    assert {name: one.found for name, one in found.items() if not one.ok} == {}
    assert not [one.fix for one in found.values() if one.fix]
    assert found["can.driver"].found == "gs_usb"
    assert "gs_usb" in found["can.driver"].found
    assert "1-2" in found["power.usb"].found
    subjects = {name.partition(".")[0] for name in found}
    assert subjects == {"kernel", "cpu", "rights", "can", "power"}


def test_on_a_bad_machine_everything_is_to_mend_with_a_command(examined):
    found = examined(BAD, link_with(**BAD_LINK))
    fine = {name for name, one in found.items() if one.ok}
    assert fine == {"kernel.container", "can.interface", "can.driver", "can.irq_thread", "can.timestamps"}
    for one in found.values():
        assert one.ok or one.fix, one
    assert "linux-image-rt" in found["kernel.preempt_rt"].fix
    assert found["kernel.clocksource"].fix.startswith("echo tsc |")
    assert "isolcpus=3" in found["cpu.isolated"].fix
    assert "25 (eth0)" in found["cpu.irq_affinity"].found
    assert "24" not in found["cpu.irq_affinity"].found  # the card's own may come there
    assert "echo 7 |" in found["cpu.irq_affinity"].fix
    assert "bitrate 1000000" in found["can.bitrate"].fix
    assert "listen-only off" in found["can.mode"].fix
    assert found["power.usb"].fix == "echo on | sudo tee /sys/devices/pci0/usb1/1-2/power/control"
    assert "500 kbit/s; the rig file says 1000" in found["can.bitrate"].found


@pytest.mark.parametrize(
    ("check", "files", "info"),
    [
        ("kernel.preempt_rt", {"proc/version": BAD["proc/version"], "sys/kernel/realtime": None}, {}),
        ("kernel.swap", {"proc/swaps": BAD["proc/swaps"]}, {}),
        ("cpu.governor", {f"{CPUS}/cpu3/cpufreq/scaling_governor": "powersave"}, {}),
        ("cpu.isolated", {f"{CPUS}/isolated": "0-2"}, {}),
        ("rights.rtprio", {"proc/self/limits": LIMITS.format(memlock="unlimited", rtprio="79")}, {}),
        ("rights.memlock", {"proc/self/limits": LIMITS.format(memlock="8388608", rtprio="95")}, {}),
        ("can.irq_thread", {"proc/210/stat": stat(50)}, {}),
        ("can.irq_thread", {"proc/210/stat": stat(80)}, {}),
        ("can.irq_thread", {"proc/210/stat": stat(0)}, {}),
        ("can.txqueuelen", {"sys/class/net/can0/tx_queue_len": "1000"}, {}),
        ("can.state", {}, {"state": "BUS-OFF"}),
        ("can.sample_point", {}, {"bittiming": {"bitrate": 1000000, "sample_point": "0.700"}}),
        ("can.berr_reporting", {}, {"ctrlmode": []}),
        ("can.error_counters", {}, {"berr_counter": {"tx": 0, "rx": 1}}),
    ],
)
def test_each_fault_alone_is_one_finding(examined, check, files, info):
    found = examined(files, link_with(**info))
    assert [name for name, one in found.items() if not one.ok] == [check]


def test_the_thread_of_the_cards_interrupt_is_raised_above_the_host(examined):
    found = examined({"proc/210/stat": stat(50)})["can.irq_thread"]
    assert found.found.startswith("irq/24-can0: SCHED_FIFO 50; the host polls at 80")
    assert found.fix == "sudo chrt -f -p 90 $(pgrep -x irq/24-can0)"


def test_a_usb_cards_interrupt_is_the_usb_controllers(examined):
    files = {
        "proc/irq/24/can0/x": None,
        "proc/irq/24/xhci_hcd/x": "",
        "sys/devices/pci0/msi_irqs/24": "msi",
        "proc/210/comm": "irq/24-xhci_hcd",
    }
    assert examined(files)["can.irq_thread"].ok
    low = examined(files | {"proc/210/stat": stat(50)})["can.irq_thread"]
    assert low.fix == "sudo chrt -f -p 90 $(pgrep -x irq/24-xhci_hcd)"


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"proc/210/comm": "python"}, "no interrupt of can0 has a thread"),
        ({"proc/version": BAD["proc/version"], "sys/kernel/realtime": None}, "no PREEMPT_RT kernel"),
    ],
)
def test_where_no_thread_empties_the_card_none_is_to_raise(examined, files, told):
    found = examined({"proc/210/stat": stat(50), **files})["can.irq_thread"]
    assert found.ok
    assert told in found.found


def test_a_capability_stands_for_the_limits(examined):
    status = GOOD["proc/self/status"].replace("0000000000000000", "0000000000800000").replace("1000", "0")
    found = examined({"proc/self/limits": BAD["proc/self/limits"], "proc/self/status": status})
    assert found["rights.rtprio"].ok
    assert found["rights.memlock"].ok


def test_without_the_latency_device_deep_sleep_is_to_mend(examined):
    found = examined({"dev/cpu_dma_latency": None})
    assert {name for name, one in found.items() if not one.ok} == {"rights.dma_latency", "cpu.c_states"}
    assert "C6 takes 133 us" in found["cpu.c_states"].found


def test_a_container_has_no_sysfs_of_its_own(examined):
    hidden = {name: None for name in GOOD if name.startswith(("sys/devices/system/cpu/cpu", "dev", "proc/irq"))}
    found = examined(hidden | {".dockerenv": "", "sys/class/net/can0/type": None})
    assert "container (docker)" in found["kernel.container"].found
    assert found["cpu.governor"].ok
    assert not found["cpu.irq_affinity"].ok
    assert found["can.interface"].found.startswith("/sys/class/net/can0/type cannot be read")


def test_an_empty_tree_is_told_as_what_cannot_be_read(examined):
    found = examined({}, None, {})
    bad = [one for one in found.values() if not one.ok]
    assert len(bad) > 8
    for one in bad:
        assert re_said(one.found), one
    assert not [one for one in found.values() if "this check failed" in one.found]


def re_said(text):
    return any(word in text for word in ("cannot be read", "there is no", "not installed"))


@pytest.mark.parametrize("seed", range(12))
def test_rubbish_in_every_file_raises_nothing_and_is_no_praise(examined, seed):
    draw = random.Random(seed)
    kinds = [b"", b"\xff\xfe\x00", b"9" * 5000, b"-1", b"{}", b"a: b\nc", b"0x", b"1,2-", b"\n" * 99, b"5-1"]
    files = {name: draw.choice(kinds) for name in GOOD if not name.endswith("/x")}
    links = ["", "null", "[]", "[1]", "[{}]", '[{"linkinfo": 3}]', '[{"linkinfo": {"info_data": []}}]', "[" * 9999]
    found = examined(files, draw.choice(links))
    assert not [one for one in found.values() if "this check failed" in one.found]
    for name in ("kernel.preempt_rt", "kernel.swap", "rights.rtprio"):
        assert not found[name].ok


@pytest.mark.thorough
@pytest.mark.parametrize("value", ["x", None, [], {}, -1, True, "9" * 400])
@pytest.mark.parametrize("key", list(LINK["linkinfo"]["info_data"]))
def test_rubbish_of_ip_raises_nothing(examined, key, value):
    found = examined(link=link_with(**{key: value}))
    assert not [one for one in found.values() if "this check failed" in one.found]


def test_what_is_no_can_interface_is_left_alone(examined):
    """A command that takes a network card down would end the session of who reads it."""
    found = examined({"sys/class/net/can0/type": "1"})
    assert [name for name in found if name.startswith("can.")] == ["can.interface"]
    assert "ip link" not in found["can.interface"].fix


def test_a_virtual_interface_has_no_controller_to_mend(examined):
    found = examined({"sys/class/net/can0/tx_queue_len": "1000"}, link={"linkinfo": {"info_kind": "vcan"}})
    assert not [one for name, one in found.items() if name.startswith("can.") and not one.ok]
    assert "no controller" in found["can.bitrate"].found


def test_what_a_card_cannot_do_is_not_to_mend(examined):
    found = examined(link=link_with(ctrlmode=[], ctrlmode_supported=["LOOPBACK"]))["can.berr_reporting"]
    assert found.ok
    assert "cannot" in found.found
    assert not examined(link=link_with(ctrlmode=[], ctrlmode_supported=["BERR-REPORTING"]))["can.berr_reporting"].ok


def test_an_interface_that_is_missing_is_told_with_those_that_are_there(examined):
    found = examined(addresses={"": parse_address("socketcan:can7")})
    assert [name for name in found if name.startswith("can.")] == ["can.interface"]
    assert "CAN interfaces here: can0" in found["can.interface"].found


def test_the_checks_of_several_buses_have_their_names(examined):
    found = examined(addresses={"a": parse_address("socketcan:can0"), "b": parse_address("coulombus:x")})
    assert found["can.up.a"].ok
    assert "virtual" in found["can.interface.b"].found


def test_the_script_is_one_that_a_shell_can_read_and_runs_nothing_found(examined):
    found = list(examined(BAD, link_with(**(BAD_LINK | {"state": "$(touch /tmp/x)\n`id`"}))).values())
    text = script(found)
    assert subprocess.run(["sh", "-n"], input=text, text=True, check=False).returncode == 0
    assert "touch" not in "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    assert text.count("isolcpus=3 ") == 1
    assert "reboot" not in text


def test_a_check_that_fails_is_a_finding_and_no_end():
    (found,) = examine([("x.y", lambda: 1 / 0)])
    assert not found.ok
    assert "ZeroDivisionError" in found.found
    (found,) = examine([("x.y", lambda: Outcome(True, "fine", "rm -rf x"))])
    assert found.fix == ""


@pytest.mark.parametrize(("online", "cpu", "mask"), [(4, 3, "7"), (2, 0, "2"), (40, 39, "7f,ffffffff"), (1, 0, "1")])
def test_the_mask_of_the_other_processors(online, cpu, mask):
    assert others_mask(frozenset(range(online)), cpu) == mask


def test_the_lists_of_processors():
    assert cpu_list("0-2,5\n") == {0, 1, 2, 5}
    assert cpu_list("") == frozenset()
    for text in ("x", "3-1", "-1", "99999999", "1-"):
        with pytest.raises(ValueError, match=r"\S"):
            cpu_list(text)


def test_the_cycle_takes_an_isolated_processor_where_it_may(tmp_path, monkeypatch):
    folder = tmp_path / CPUS
    folder.mkdir(parents=True)
    (folder / "online").write_text("0-3")
    (folder / "isolated").write_text("2-3,9")
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("os.sched_setaffinity", lambda pid, cpus: None)
    assert (bus_cpu(tmp_path), default_cpu(tmp_path)) == (0, 3)

    def refused(pid, cpus):
        if cpus != {0, 1}:
            raise OSError(22, "Invalid argument")

    monkeypatch.setattr("os.sched_setaffinity", refused)
    assert (bus_cpu(tmp_path), default_cpu(tmp_path)) == (0, 1)
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {1})
    assert bus_cpu(tmp_path) is default_cpu(tmp_path) is None
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    (folder / "isolated").write_text("rubbish")
    assert default_cpu(tmp_path) == 1


def test_every_check_is_in_the_document(examined):
    text = (ROOT / "docs" / "doctor.md").read_text()
    names = [*examined(), "latency", "disk.free", *(name for name, _ in software.checks())]
    assert [name for name in names if f"| `{name}` |" not in text] == []


# software and disk


@pytest.mark.parametrize(
    ("scopes", "is_ok", "text"),
    [
        ({"run", "simulate", "arm"}, True, "kept in /cache"),
        ({"run", "simulate"}, True, "kept in /cache; for an arm in the plane: coulombus warm-up"),
        ({"run"}, True, "kept in /cache; for virtual time and an arm in the plane: coulombus warm-up"),
        (set(), False, "not all code is in /cache: the first start compiles"),
    ],
)
def test_what_a_first_start_compiles_is_named(monkeypatch, scopes, is_ok, text):
    monkeypatch.setattr(decorator, "CACHE_DIR", Path("/cache"))
    monkeypatch.setattr(decorator, "is_warm", lambda scope="arm": scope in scopes)
    outcome = software.compiled()
    assert (outcome.ok, outcome.found) == (is_ok, text)


def test_another_module_of_this_name_is_found(tmp_path):
    own = tmp_path / "own" / "coulombus"
    for folder in (own, tmp_path / "other" / "coulombus"):
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()
    (tmp_path / "file").mkdir()
    (tmp_path / "file" / "coulombus.py").touch()
    assert software.import_name([str(tmp_path / "own"), str(tmp_path)], own).ok
    path = [str(tmp_path / name) for name in ("own", "other", "file", "nowhere")]
    found = software.import_name(path, own)
    assert not found.ok
    assert str(tmp_path / "other" / "coulombus") in found.found
    assert "coulombus.py" in found.found


def test_a_folder_that_holds_a_clone_hides_a_package_that_is_on_no_path(tmp_path, monkeypatch):
    (tmp_path / "coulombus" / "coulombus").mkdir(parents=True)
    own = tmp_path / "coulombus" / "coulombus"
    (own / "__init__.py").touch()
    monkeypatch.chdir(tmp_path)
    found = software.import_name([str(tmp_path / "bin")], own)
    assert not found.ok
    assert str(own.parent) in found.found
    assert "work in another folder" in found.fix
    assert software.import_name([str(own.parent)], own).ok  # a package wins over a folder
    monkeypatch.chdir(own.parent)
    assert software.import_name([str(tmp_path / "bin")], own).ok


def test_another_program_of_this_name_is_found_where_the_shell_takes_it(tmp_path):
    for folder in ("env/bin", "other"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "coulombus").write_text("#!/bin/sh\n")
        (tmp_path / folder / "coulombus").chmod(0o755)
    env, other = str(tmp_path / "env/bin"), str(tmp_path / "other")
    assert software.script_name([env, other], tmp_path / "env").ok
    assert not software.script_name([other, env], tmp_path / "env").ok
    assert software.script_name(["", "/proc/nonexistent"], tmp_path / "env").ok


@pytest.mark.parametrize(
    ("bounds", "version", "met"),
    [
        (">=2.4,<3", "2.4.1", True),
        (">=2.4,<3", "3.0", False),
        (">=2.4,<3", "2.3.9", False),
        (">=40", "40", True),
        ("", "1", True),
        ("nonsense", "1", True),
        (">=1.2", "1.2rc1", True),
    ],
)
def test_the_bounds_of_versions(bounds, version, met):
    assert software.requirement_met(bounds, version) is met


def test_a_library_that_is_too_old_or_missing_is_told():
    needs = ["click>=8.1", "numba>=0.60", 'pytest>=9; extra == "dev"']
    versions = {"coulombus": "0.1.0", "click": "7.0"}

    def version(name):
        if name not in versions:
            raise software.metadata.PackageNotFoundError(name)
        return versions[name]

    found = software.versions(lambda name: needs, version)
    assert not found.ok
    assert found.found == "click is 7.0, expected >=8.1; numba is missing"


def test_a_folder_that_is_missing_has_no_room(tmp_path):
    with pytest.raises(CannotRead):
        free(tmp_path / "none", WANTED)
    assert not free(tmp_path, replace(WANTED, period_s=1e-15)).ok


# the latency test


def wakeups(late, latest):
    return Wakeups(Counter(late), latest)


def test_a_machine_that_wakes_in_time_is_fit():
    found = judge(Latency(wakeups({20: 9990, 60: 10}, 61.0), None, "", (), 2), WANTED)
    assert found.ok
    assert found.found.startswith("fit for 1 kHz with 3 ms watchdogs")
    assert found.as_dict()["figures"]["fit"] is True


@pytest.mark.parametrize(
    ("late", "latest", "refused", "why"),
    [
        ({20: 9999, 2500: 1}, 2500.0, (), "2.50 ms late, and a watchdog ends at 3 ms"),
        ({20: 90, 900: 10}, 900.0, (), "10.00% of the periods are lost"),
        ({20: 970, 150: 30}, 150.0, (), "one wake-up in a hundred"),
        ({20: 1000}, 20.0, ("SCHED_FIFO",), "SCHED_FIFO was refused"),
        ({}, 0.0, (), "100.00% of the periods are lost"),
    ],
)
def test_what_makes_a_machine_unfit_is_said(late, latest, refused, why):
    found = judge(Latency(wakeups(late, latest), None, "", refused, 2), WANTED)
    assert not found.ok
    assert found.found.startswith("not fit for 1 kHz")
    assert why in found.found


def test_spread_and_bars_of_the_wake_ups():
    own = wakeups({1: 5, 30: 900, 700: 95}, 700.5)
    assert (own.total, own.at(0.5), own.at(1.0), own.beyond(600)) == (1000, 31.0, 700.5, 95)
    rows = bars(Latency(own, wakeups({3: 1000}, 3.0), "", (), 1))
    assert [row[1] for row in rows if row[1]] == [5, 900, 95]
    assert sum(row[3] for row in rows) == 1000
    assert rows[-1][0] == "500 - 1000 us"
    assert bars(Latency(Wakeups(), None, "", (), 1)) == []


def test_cyclictests_histogram_is_read():
    text = "# Histogram\n000000 000000\n000012\t000345\n000013\t000005\n# Total: 000000350\n# Max Latencies: 00047\n"
    assert read_cyclictest(text + "# Histogram Overflows: 00002\n") == ({12: 345, 13: 5, 19999: 2}, 47.0)
    for rubbish in ("", "T: 0", "# Max Latencies: x"):
        with pytest.raises(LatencyError):
            read_cyclictest(rubbish)


def test_a_reference_that_fails_is_told_and_the_test_goes_on(tmp_path, monkeypatch):
    program = tmp_path / "cyclictest"
    program.write_text("#!/bin/sh\necho 'FATAL: no rights' >&2; exit 1\n")
    program.chmod(0o755)
    monkeypatch.setattr("coulombus.host.doctor.latency.which", lambda name: str(program))
    told = json.dumps({"counts": {"7": 3}, "latest_us": 7.5, "real_time": [{"name": "SCHED_FIFO", "granted": False}]})
    monkeypatch.setattr("coulombus.host.doctor.latency._module", lambda name, *words: ["echo", told])
    spent = []
    found = measure_latency(0.02, WANTED, cpu=None, loads=0, progress=spent.append)
    assert found.reason == "cyclictest: FATAL: no rights"
    assert (found.cyclictest, found.own.total, found.refused) == (None, 3, ("SCHED_FIFO",))
    assert spent


@pytest.mark.thorough
@pytest.mark.real_time
@pytest.mark.skipif(JIT_DISABLED, reason="plain Python is no real-time loop")
def test_the_loop_is_measured_beside_a_load():
    found = measure_latency(0.2, WANTED, cpu=default_cpu(), priority=None, loads=2)
    assert found.own.total > 0
    assert found.loads == 2
    assert judge(found, WANTED).figures["own"]["wakeups"] == found.own.total


# the verb


def test_the_document_of_the_verb_is_what_is_promised(monkeypatch):
    for words in ("doctor --json", "doctor --bus socketcan:none7 --json"):
        done = CliRunner().invoke(main, words.split())
        told = json.loads(done.stdout)
        assert all(list(one) == ["check", "ok", "found", "fix"] for one in told)
        assert done.exit_code == (0 if all(one["ok"] for one in told) else 1)
        assert "none7" not in words or done.exit_code == 1


def test_the_script_and_the_document_are_not_given_together():
    assert CliRunner().invoke(main, ["doctor", "--fix", "--json"]).exit_code == 2
    done = CliRunner().invoke(main, shlex.split("doctor --bus socketcan:none7 --fix"))
    assert done.exit_code == 1
    assert done.stdout.startswith("#!/bin/sh\n")


def test_each_line_is_right_at_eighty_columns():
    done = CliRunner().invoke(main, ["doctor"])
    lines = [line for line in done.stdout.splitlines() if not line.startswith("        ")]
    assert max(map(len, lines)) <= 80


def test_the_root_of_a_machine_is_a_path(tmp_path):
    assert Machine(tmp_path).path("/proc/x") == Path(tmp_path, "proc/x")
