"""The header for C and C++: it compiles, and its example speaks the protocol."""

import shutil
import subprocess

import pytest

from coulombus.host.world.protocol import Kind
from coulombus.host.world.records import MODEL, STATE
from places import ROOT
from world_bench import Bench

HEADER = ROOT / "examples/worlds/coulombus_world.h"
EXAMPLE = ROOT / "examples/worlds/wall.c"
COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler `cc` here")


def compiled(source, target, *options):
    subprocess.run([COMPILER, "-Wall", "-Wextra", "-Werror", *options, "-o", target, source], check=True, timeout=120)
    return target


@needs_compiler
def test_each_field_has_the_offset_of_the_record(tmp_path):
    records = {"model": MODEL, "state": STATE}
    lines = [
        f'printf("{kind} {name} %zu\\n", offsetof(struct coulombus_{kind}, {name}));'
        for kind, dtype in records.items()
        for name in dtype.names
    ]
    source = tmp_path / "offsets.c"
    source.write_text(f'#include "{HEADER}"\nint main(void) {{\n' + "\n".join(lines) + "\nreturn 0;\n}\n")
    program = compiled(source, tmp_path / "offsets", "-std=gnu11", "-Wno-unused-function")
    told = subprocess.run([program], check=True, capture_output=True, text=True, timeout=60).stdout.splitlines()
    assert told == [f"{kind} {name} {dtype.fields[name][1]}" for kind, dtype in records.items() for name in dtype.names]


def test_the_kinds_are_those_of_the_protocol():
    line = next(line for line in HEADER.read_text().splitlines() if "COULOMBUS_HELLO = 1" in line)
    names = [name.split("=")[0].strip() for name in line.partition("{")[2].partition("}")[0].split(",")]
    assert names == [f"COULOMBUS_{kind.name}" for kind in Kind]


@needs_compiler
@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler `c++` here")
def test_the_header_compiles_as_c_plus_plus(tmp_path):
    source = tmp_path / "world.cpp"
    source.write_text(f'#include "{HEADER}"\nint main() {{ return coulombus_model(0.1).head.size == 776 ? 0 : 1; }}\n')
    options = "-std=c++17", "-Wno-unused-function", "-Wall", "-Werror"
    subprocess.run(["c++", *options, "-o", tmp_path / "world", source], check=True, timeout=120)
    subprocess.run([tmp_path / "world"], check=True, timeout=60)


@needs_compiler
@pytest.mark.usefixtures("private_sockets")
def test_the_example_displays_a_wall_and_prints_where_the_handle_is(tmp_path):
    program = compiled(EXAMPLE, tmp_path / "wall", "-std=gnu11")
    with Bench() as bench:
        process = subprocess.Popen([program, "x", "1000"], stdout=subprocess.PIPE, text=True)
        bench.until(lambda: bench.server.readers == 1)
        for _ in range(1000):
            bench.cycle()
        out, _ = process.communicate(timeout=60)
        bench.until(lambda: len(bench.display.models) == 100)
    assert process.returncode == 0
    assert out.splitlines() == ["250.000 rad, wall 0.000 Nm", "500.000 rad, wall 0.000 Nm"]
    model = bench.display.models[-1]
    assert (model["parts"], model["wall_K_Nm_rad"], model["law"], model["sequence"]) == (1, 2.0, 0.0, 100)
