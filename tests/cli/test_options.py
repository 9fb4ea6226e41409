"""Options are declared once; those that belong together reach a verb as one value."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated

import click
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.cli.options import argument, option, with_options, words
from coulombus.cli.rig_options import BusesOptions, OneBusOptions, RigOptions
from coulombus.rigs.overrides import SHARED_MACHINE, shared_machine


@dataclass(frozen=True)
class Pair:
    """Two options."""

    first: Annotated[int, option("The one.", default=3)]
    second: Annotated[tuple[str, ...], option("--2nd", "-s", "The other.", metavar="TEXT")]


@dataclass(frozen=True)
class Triple(Pair):
    """Two options, a flag and a number."""

    to_rig: Annotated[bool, option("The flag.")]
    speed: Annotated[float | None, option("-v", "The number.", type=float)]


@pytest.fixture
def verb():
    got = []

    @click.command()
    @with_options
    def command(
        place: Annotated[Path, argument(type=click.Path(path_type=Path))],
        pair: Pair,
        third_time: Annotated[bool, option("--not a flag, but help")],
    ) -> None:
        got.append((place, pair, third_time))

    return command, got


def test_a_verb_gets_the_values_as_one_and_its_own_beside_it(verb):
    command, got = verb
    assert CliRunner().invoke(command, ["x", "--2nd", "a", "--third-time", "-s", "b"]).exit_code == 0
    assert CliRunner().invoke(command, ["y", "--first", "-2"]).exit_code == 0
    assert got == [(Path("x"), Pair(3, ("a", "b")), True), (Path("y"), Pair(-2, ()), False)]


def test_the_help_has_the_options_in_their_order(verb):
    text = CliRunner().invoke(verb[0], ["--help"]).output
    assert "--first INTEGER  The one.  [default: 3]" in text
    assert "-s, --2nd TEXT" in text
    assert "--third-time     --not a flag, but help" in text
    assert text.index("--first") < text.index("--2nd") < text.index("--third-time")


@pytest.mark.parametrize("line", ["--first -2 --2nd a --2nd b", "--first 3 --to-rig -v 0.1234567", "--first 3"])
def test_the_words_of_a_value_give_it_again(line):
    got = []

    @click.command()
    @with_options
    def command(triple: Triple) -> None:
        got.append(triple)

    assert CliRunner().invoke(command, line.split()).exit_code == 0
    assert words(got[0]) == line.split()
    assert words(got[0], Pair, without=["second"]) == line.split()[:2]


def test_a_whole_number_of_seconds_has_no_point_in_the_words():
    assert words(Triple(3, ("x=1.0",), False, 13.0), without=["first"]) == ["--2nd", "x=1.0", "-v", "13"]


def test_what_is_set_by_hand_counts_more_than_what_comes_before_it():
    key, value = next(text.split("=") for text in SHARED_MACHINE if text.startswith("limits."))
    name = key.removeprefix("limits.")
    shared, own = RigOptions("bench", ()).load(*SHARED_MACHINE), RigOptions("bench", (f"{key}={2 * float(value):g}",))
    assert getattr(shared.one_axis().limits, name) == float(value)
    assert getattr(own.load(*SHARED_MACHINE).one_axis().limits, name) == 2 * float(value)


@pytest.mark.parametrize(
    ("period_s", "own", "cycles"), [(0.001, 3, 50), (0.0005, 3, 50), (0.005, 3, 10), (0.005, 12, 12), (0.02, 1, 3)]
)
def test_a_missed_message_may_take_50_ms_on_a_shared_machine(period_s, own, cycles):
    bus = SimpleNamespace(period_s=period_s)
    axis = SimpleNamespace(bus=bus, limits=SimpleNamespace(missed_tpdo_cycles=own))
    overrides = shared_machine(SimpleNamespace(axes=(axis,)))
    assert f"limits.missed_tpdo_cycles={cycles}" in overrides
    assert len(overrides) == len(SHARED_MACHINE)


def test_a_rig_and_its_buses_are_found_together():
    rig, address = OneBusOptions("two_axes", ("bus.bitrate_bit_s=1000000",), "coulombus:here", None).resolve()
    assert (rig.name, str(address), rig.bus.bitrate_bit_s) == ("two_axes", "coulombus:here", 1_000_000)
    one = BusesOptions("bench", (), ("coulombus:there",), None)
    assert [str(found) for found in one.addresses(one.load()).values()] == ["coulombus:there"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("watch --interval 1 --foxglove", "--interval is of the table in a terminal: leave it or --foxglove out"),
        ("watch --web --plotjuggler", "--web and --plotjuggler: choose one of them"),
        ("run --web-after 10", "--web-after is of the page: give --web, too"),
        ("watch --pcapng - --json", "--pcapng shows nothing: leave --json out"),
        ("watch --scope motor.position_rad", "--scope draws in a terminal: leave it out"),
        ("lss --bus coulombus:none --all", "--all goes with --set-id, and not with --device"),
        ("lss --bus coulombus:none --bitrate 500k", "add --store, or the device forgets it"),
        ("lss --bus coulombus:none --bitrate 333333 --store", "--bitrate"),
        ("init --drive bench", "give --drive and --brake, or --bus to ask who is there"),
        ("init --drive bench --brake bench --drive-id 2 --brake-id 2", "each device has a node id of its own"),
        ("set --undo F_s=2 --bus coulombus:none", "--undo takes the last change back: leave the values out"),
        ("experiment study.toml -o out --subject S01 --port 80", "--port is the page's; add --page"),
        ("experiment s.toml -o out --subject S01 --virtual --bus coulombus:x", "take --bus and --shared-machine out"),
        ("replay run.pcapng --bus coulombus:x --host", "give one of --bus B"),
        ("replay run.pcapng --virtual --law dahl", "--law and --set go with --host"),
    ],
)
def test_options_that_do_not_go_together_are_refused(line, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.pcapng").touch()
    result = CliRunner().invoke(main, line.split())
    assert result.exit_code == 2
    assert reason in result.stderr
