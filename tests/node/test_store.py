"""Parameters that survive: 1010h, 1011h, 1020h, and a file that survives a power cut at any
instant.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

import coulombus.node.store
from coulombus.cli.main import main
from coulombus.node.store import FileStore
from node_bench import Bench, SdoAborted

SAVE, LOAD = b"save", b"load"
RESET_NODE, RESET_COMMUNICATION = 129, 130


def powered(store=None, name="motor", node_id=1) -> Bench:
    bench = Bench(name, node_id, store=store)
    bench.power_on()
    bench.take()
    return bench


def values(bench: Bench) -> tuple[int, int, int]:
    """A value of each group: communication, application, manufacturer's."""
    return bench.number(0x1017), bench.number(0x6087), bench.number(0x2002)


def write(bench: Bench, heartbeat: int, slope: int, sync_us: int) -> None:
    bench.write(0x1017, 0, heartbeat, 2)
    bench.write(0x6087, 0, slope, 4)
    bench.write(0x2002, 0, sync_us, 4)


DEFAULTS = (0, 10_000_000, 0)


@pytest.mark.parametrize(
    ("subindex", "kept"),
    [(1, (250, 7, 9000)), (2, (250, *DEFAULTS[1:])), (3, (0, 7, 0)), (4, (0, DEFAULTS[1], 9000))],
)
def test_each_group_is_stored_and_restored(subindex, kept):
    bench = powered()
    write(bench, 250, 7, 9000)
    bench.download(0x1010, subindex, SAVE)
    write(bench, 100, 5, 5)
    bench.nmt(RESET_NODE)
    assert values(bench) == kept
    bench.download(0x1011, subindex, LOAD)
    assert values(bench) == kept  # not before the reset
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS


def test_reset_communication_brings_back_the_stored_communication_parameters_only():
    bench = powered()
    write(bench, 250, 7, 9000)
    bench.download(0x1010, 1, SAVE)
    write(bench, 100, 5, 5)
    bench.nmt(RESET_COMMUNICATION)
    assert values(bench) == (250, 5, 5)
    bench.download(0x1011, 1, LOAD)
    bench.nmt(RESET_COMMUNICATION)
    assert values(bench) == (0, 5, 5)
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS


def test_what_is_stored_acts_after_the_reset():
    bench = powered()
    bench.write(0x1017, 0, 10, 2)
    bench.write(0x1800, 1, 0xC00001F1, 4)
    bench.write(0x1A00, 0, 0, 1)
    bench.write(0x1A00, 1, 0x606C0020, 4)
    bench.write(0x1A00, 0, 1, 1)
    bench.write(0x1800, 1, 0x400001F1, 4)
    bench.download(0x1010, 1, SAVE)
    bench.device.power_off()
    bench.power_on()
    bench.take()
    bench.nmt(1)
    bench.sync()
    (frame,) = bench.take(0x1F1)
    assert len(frame.data) == 4
    bench.run(30_000_000)
    assert len(bench.take(0x701)) == 3


@pytest.mark.parametrize("data", [b"evas", b"SAVE", b"load", bytes(4), b"\1\0\0\0"])
def test_another_signature_stores_nothing(data):
    bench = powered()
    write(bench, 250, 7, 9000)
    with pytest.raises(SdoAborted, match="08000020"):
        bench.download(0x1010, 1, data)
    with pytest.raises(SdoAborted, match="08000020"):
        bench.download(0x1011, 1, SAVE if data == LOAD else data)
    assert bench.number(0x1010, 1) == bench.number(0x1011, 1) == 1  # it stores on command
    bench.nmt(RESET_NODE)
    assert values(bench) == DEFAULTS


def test_set_points_are_never_stored():
    bench = powered(name="mr_brake", node_id=2)
    bench.write(0x7300, 1, 3000, 2)
    bench.write(0x6340, 1, 0, 1)
    bench.download(0x1010, 1, SAVE)
    bench.nmt(RESET_NODE)
    assert (bench.number(0x7300, 1), bench.number(0x6340, 1)) == (0, 0)
    bench.run(600_000_000)  # the ramp to off
    assert bench.node.out_brake_Nm == 0


def test_verify_configuration_holds_until_a_parameter_changes():
    bench = powered()
    bench.write(0x1020, 1, 15000, 4)
    bench.write(0x1020, 2, 3600000, 4)
    bench.download(0x1010, 1, SAVE)
    bench.nmt(RESET_NODE)
    bench.write(0x1017, 0, 0, 2)  # no change
    bench.write(0x6040, 0, 6, 2)  # a command, no parameter
    assert (bench.number(0x1020, 1), bench.number(0x1020, 2)) == (15000, 3600000)
    bench.write(0x1017, 0, 100, 2)
    assert (bench.number(0x1020, 1), bench.number(0x1020, 2)) == (0, 0)
    bench.nmt(RESET_NODE)
    assert (bench.number(0x1020, 1), bench.number(0x1020, 2)) == (15000, 3600000)


def test_the_file_outlives_the_process(tmp_path: Path):
    path = tmp_path / "motor.store"
    bench = powered(FileStore(path))
    write(bench, 250, 7, 9000)
    bench.download(0x2004, 0, "Ärmel".encode("latin-1"))
    bench.download(0x1010, 1, SAVE)
    again = FileStore(path)
    bench = powered(again)
    assert values(bench) == (250, 7, 9000)
    assert bench.upload(0x2004) == "Ärmel".encode("latin-1")
    assert again.diagnosis is None
    assert bench.device.parameters.ignored == 0
    assert os.listdir(tmp_path) == ["motor.store"]


def test_lss_settings_outlive_the_process(tmp_path: Path):
    path = tmp_path / "motor.store"
    bench = powered(FileStore(path))
    for data in ("0401", "1105", "17", "0400"):
        bench.frame(0x7E5, bytes.fromhex(data).ljust(8, b"\0"))
    bench = Bench("motor", 1, store=FileStore(path))
    bench.power_on()
    assert [frame.can_id for frame in bench.take()] == [0x705]


def test_the_file_of_another_device_is_not_used(tmp_path: Path):
    path = tmp_path / "a.store"
    bench = powered(FileStore(path))
    write(bench, 250, 7, 9000)
    bench.download(0x1010, 1, SAVE)
    store = FileStore(path)
    bench = powered(store, "mr_brake", 2)
    assert bench.number(0x1017) == 0
    assert store.diagnosis is not None
    assert "another device" in store.diagnosis
    assert str(path) in store.diagnosis


@pytest.mark.parametrize("content", [b"", b"\n", b"coulombus-store 1 2 a3830348\n{}", bytes(300)])
def test_a_foreign_file_is_not_used(tmp_path: Path, content):
    path = tmp_path / "a.store"
    path.write_bytes(content)
    store = FileStore(path)
    bench = powered(store)
    assert values(bench) == DEFAULTS
    assert store.diagnosis is not None
    bench.download(0x1010, 1, SAVE)  # and it is replaced by a whole one
    store = FileStore(path)
    powered(store)
    assert store.diagnosis is None


def test_a_file_cut_or_changed_at_any_byte_is_not_used(tmp_path: Path):
    path = tmp_path / "a.store"
    store = FileStore(path)
    store.attach("device")
    store.put({"communication": {"1017:00": b"\xfa\x00"}})
    whole = path.read_bytes()
    for cut in range(len(whole)):
        for raw in (whole[:cut], whole[:cut] + bytes((whole[cut] ^ 0x01,)) + whole[cut + 1 :]):
            path.write_bytes(raw)
            store = FileStore(path)
            store.attach("device")
            assert store.diagnosis is not None
            assert store.section("communication") == {}
    path.write_bytes(whole)
    store.attach("device")
    assert store.section("communication") == {"1017:00": b"\xfa\x00"}


def test_a_directory_that_is_not_there_is_a_hardware_error(tmp_path: Path):
    bench = powered(FileStore(tmp_path / "none" / "a.store"))
    with pytest.raises(SdoAborted, match="06060000"):
        bench.download(0x1010, 1, SAVE)


def test_stored_values_that_no_longer_fit_are_ignored():
    bench = powered()
    good = {"1017:00": b"\xfa\x00"}
    bad = {"1018:01": bytes(4), "9999:00": b"\0", "1019:00": b"\xf1", "1017:01": b"\0", "x": b"", "1006:00": b"\0"}
    bench.device.store.put({"communication": {**good, **bad}})
    bench.nmt(RESET_NODE)
    assert bench.number(0x1017) == 250
    assert bench.number(0x1018, 1) == 0x4C0
    assert bench.device.parameters.ignored == 5  # one is not writable, so it is no parameter


class PowerCut(BaseException):
    """Nobody may catch it."""


class Disk:
    """A file system that loses what was not synced, and a power supply that fails after `steps`
    system calls and bytes.

    `os` for `node.store`. A name is durable once its directory was synced, a content once its file
    was.
    """

    O_WRONLY, O_CREAT, O_EXCL, O_NOFOLLOW, O_RDONLY = os.O_WRONLY, os.O_CREAT, os.O_EXCL, os.O_NOFOLLOW, os.O_RDONLY

    def __init__(self, steps: int, old: bytes):
        self.steps = steps
        self.inodes = [{"now": old, "synced": old}]
        self.names = {"a.store": 0}
        self.synced_names = dict(self.names)
        self.open_files: dict[int, int | None] = {}

    def step(self) -> None:
        if self.steps == 0:
            raise PowerCut
        self.steps -= 1

    def open(self, path, flags, mode=0):
        self.step()
        number = 3 + len(self.open_files)
        self.open_files[number] = None
        if flags & os.O_EXCL:
            assert path.name not in self.names
            self.inodes.append({"now": b"", "synced": b""})
            self.names[path.name] = self.open_files[number] = len(self.inodes) - 1
        return number

    def write(self, number, data):
        part = bytes(data[:11])  # as few at a time as a system call may take
        for byte in part:
            self.step()
            self.inodes[self.open_files[number]]["now"] += bytes((byte,))
        return len(part)

    def fsync(self, number):
        self.step()
        inode = self.open_files[number]
        if inode is None:
            self.synced_names = dict(self.names)
        else:
            self.inodes[inode]["synced"] = self.inodes[inode]["now"]

    def close(self, number):
        pass

    def unlink(self, path):
        self.step()
        if self.names.pop(path.name, None) is None:
            raise FileNotFoundError(2, "No such file or directory")

    def replace(self, source, target):
        self.step()
        self.names[target.name] = self.names.pop(source.name)

    def survivors(self):
        """What may be found under the name after the cut."""
        for names in (self.names, self.synced_names):
            if "a.store" in names:
                inode = self.inodes[names["a.store"]]
                now, synced = inode["now"], inode["synced"]
                yield from {
                    synced,
                    now,
                    now[: (len(synced) + len(now)) // 2],
                    now[: len(now) - 1] if now != synced else now,
                }


def test_a_power_cut_at_any_instant_leaves_the_old_or_the_new(tmp_path: Path, monkeypatch):
    path = tmp_path / "a.store"
    before, after = {"communication": {"1017:00": b"\x01\x00"}}, {"communication": {"1017:00": b"\x02\x00"}}
    store = FileStore(path)
    store.attach("device")
    store.put(before)
    old = path.read_bytes()
    seen, steps, cut = set(), 0, True
    while cut:
        disk = Disk(steps, old)
        path.write_bytes(old)
        store.attach("device")
        with monkeypatch.context() as patch:
            patch.setattr(coulombus.node.store, "os", disk)
            try:
                store.put(after)
                cut = False
            except PowerCut:
                pass
        for content in disk.survivors():
            path.write_bytes(content)
            store.attach("device")
            assert store.diagnosis is None, f"torn after {steps} steps"
            seen.add(store.section("communication")["1017:00"])
        steps += 1
    assert seen == {b"\x01\x00", b"\x02\x00"}
    assert store.section("communication")["1017:00"] == b"\x02\x00"  # in the end it is the new one, whatever was lost
    assert steps > 100


def test_a_put_that_fails_keeps_what_was(tmp_path: Path, monkeypatch):
    store = FileStore(tmp_path / "a.store")
    store.attach("device")
    store.put({"communication": {"1017:00": b"\x01\x00"}})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(coulombus.node.store.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        store.put({"communication": {"1017:00": b"\x02\x00"}})
    assert store.section("communication") == {"1017:00": b"\x01\x00"}
    store.attach("device")
    assert store.section("communication") == {"1017:00": b"\x01\x00"}


def test_what_is_written_beside_follows_no_link(tmp_path: Path):
    theirs = tmp_path / "theirs"
    theirs.write_text("mine")
    (tmp_path / "store.new").symlink_to(theirs)
    store = FileStore(tmp_path / "store")
    store.attach("it")
    store.put({"communication": {"1017:00": b"\x01\x00"}})
    assert theirs.read_text() == "mine"
    assert not (tmp_path / "store.new").exists()
    again = FileStore(tmp_path / "store")
    again.attach("it")
    assert again.section("communication")["1017:00"] == b"\x01\x00"


def test_another_kind_of_file_is_not_replaced(tmp_path: Path):
    path = tmp_path / "rig.toml"
    path.write_text("[rig]\n")
    store = FileStore(path)
    store.attach("it")
    assert store.foreign
    with pytest.raises(OSError, match="is not the store of a device"):
        store.put({"communication": {"1017:00": b"\x01\x00"}})
    assert path.read_text() == "[rig]\n"
    done = CliRunner().invoke(
        main, ["node", "eds/motor.eds", "--node-id", "1", "--bus", "coulombus:none", "--store", str(path)]
    )
    assert done.exit_code == 2
    assert "choose another file; this one is not overwritten" in done.output
