"""``coulombus init``: draft a rig file for devices without one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import InputPath, OutputFile
from coulombus.cli.options import option, with_options
from coulombus.cli.tables import echo, table_console
from coulombus.eds.drive_axis import MOST_DRIVE_AXES
from coulombus.system.exit import say, verdict
from coulombus.system.quoting import shell

if TYPE_CHECKING:
    from coulombus.rigs.draft.discover import DeviceChoice
    from coulombus.rigs.rig import Rig

__all__ = ["init"]

NODE_ID = click.IntRange(1, 127)
TABLE_COLUMNS = 110


@dataclass(frozen=True)
class Wishes:
    """The devices of the new rig, from the options."""

    drive: Annotated[
        str, option("EDS or XDD file of the motor's drive; `bench`: this project's.", default="", metavar="F.eds")
    ]
    brake: Annotated[
        str, option("EDS or XDD file of the brake's driver; `bench`: this project's.", default="", metavar="G.eds")
    ]
    sensors: Annotated[
        tuple[str, ...], option("--sensor", "EDS file of a further node: the handle's transducer.", metavar="H.eds")
    ]
    drive_id: Annotated[int | None, option("Node id of the drive.  [default: a DCF's own, else 1]", type=NODE_ID)]
    brake_id: Annotated[
        int | None, option("Node id of the brake's driver.  [default: a DCF's own, else 2]", type=NODE_ID)
    ]
    sensor_ids: Annotated[
        tuple[int, ...], option("--sensor-id", "Node id of each sensor, in their order.", type=NODE_ID)
    ]
    drive_axis: Annotated[
        int,
        option(
            "--axis",
            "Which axis of the drive, where it has several: objects from 6000h, 6800h ...",
            type=click.IntRange(1, MOST_DRIVE_AXES),
            default=1,
        ),
    ]

    def check(self, live: bool) -> None:
        """Refuse missing or contradictory options.

        Parameters
        ----------
        live : the devices of a bus are identified

        Raises
        ------
        click.UsageError
            The text names the missing or superfluous options.
        """
        if not live and not (self.drive and self.brake):
            raise click.UsageError("give --drive and --brake, or --bus to ask who is there")
        if len(self.sensor_ids) > len(self.sensors):
            raise click.UsageError("--sensor-id is given more often than --sensor")
        node_ids = [node_id for node_id in (self.drive_id, self.brake_id, *self.sensor_ids) if node_id is not None]
        if len(set(node_ids)) < len(node_ids):
            raise click.UsageError("each device has a node id of its own")

    def devices(self) -> list[DeviceChoice]:
        """Return the devices by their names in the rig file."""
        from coulombus.rigs.draft.discover import DeviceChoice

        devices = [
            DeviceChoice("motor", self.drive, self.drive_id, self.drive_axis),
            DeviceChoice("brake", self.brake, self.brake_id),
        ]
        for number, (eds, node_id) in enumerate(zip_longest(self.sensors, self.sensor_ids), 1):
            devices.append(DeviceChoice("transducer" if number == 1 else f"sensor_{number}", eds, node_id))
        return devices


@click.command(epilog=EXIT_STATUS)
@with_options
def init(
    wishes: Wishes,
    like: Annotated[str, option("Rig that gives all other values.", default="bench", metavar="R")],
    bus_name: Annotated[
        str | None, option("--bus", "Identify the devices on coulombus:NAME or socketcan:IF.", metavar="B")
    ],
    eds_folder: Annotated[
        Path | None,
        option(
            "Folder with the EDS files of the devices on the bus; this project's are known.",
            type=InputPath(file_okay=False),
        ),
    ],
    accepted: Annotated[
        tuple[str, ...],
        option(
            "--accept",
            'Acknowledge this of a device (host.accept): "motor: 6071h can be mapped". May be given several times.',
            metavar="TEXT",
        ),
    ],
    rehearse: Annotated[bool, option("Add a simulated rig, for `coulombus simulate`; refused on a real bus.")],
    no_trials: Annotated[bool, option("With --rehearse: do not try the guesses with their other readings.")],
    output: Annotated[
        Path | None,
        option(
            "-o", "--out", "--output", "A new file.  [default: stdout]", type=OutputFile(".toml"), metavar="MY.toml"
        ),
    ],
) -> None:
    """Write a rig file for a drive and a brake's driver, from their EDS files.

    Every role is bound, and every guess is marked `# CHECK:` with its reason. What a device cannot
    do is not acknowledged: `coulombus check` names it. A file that exists is never replaced. With
    --bus the live devices are asked, and those that no option names are found in --eds-folder by
    their identity (1018h). With --rehearse each guess about the drive is tried with its other readings
    in virtual time: a table says what notices a wrong one, and how far, how fast and how strongly the
    handle moves until then. A device that cannot have its role is refused (3): a drive without a
    torque or current set-point, for one.

    \b
    Examples:
      coulombus init --drive vendor.eds --brake bench -o my-rig.toml
      coulombus init --drive vendor.eds --brake io.eds --sensor amplifier.eds --drive-id 5
      coulombus init --drive vendor.eds --brake bench --rehearse -o try.toml
      coulombus init --drive dual.eds --axis 2 --brake bench -o second.toml
      coulombus init --bus socketcan:can0 --eds-folder eds -o my-rig.toml
    """
    wishes.check(live=bus_name is not None)
    with errors():
        from coulombus.rigs.draft.discover import gather
        from coulombus.rigs.draft.draft import Draft
        from coulombus.rigs.draft.draft_text import CHECK
        from coulombus.rigs.rig import load_rig

        folder = None if output is None else output.parent.resolve()
        answered = {} if bus_name is None else _answered(bus_name, wishes.drive_axis)
        devices = gather(wishes.devices(), folder, answered, eds_folder)
        path = "rig.toml" if output is None else str(output)
        draft = Draft(devices, load_rig(like).one_axis(), path, rehearse=rehearse, accept=accepted)
        if rehearse:
            draft.acknowledge(_acknowledgements(draft.rig))
        text = str(draft)
        if output is None:
            echo(text, nl=False)
        else:
            with output.open("x", encoding="utf-8") as file:  # `x`: never overwrite a file created meanwhile
                file.write(text)
        if rehearse and not no_trials:
            _tell_trials(draft.rig, text, err=output is None)
        with verdict(0):
            count, name = text.count(f"# {CHECK}:"), "it" if output is None else str(output)
            say(
                f"coulombus: guesses marked '# {CHECK}:' in {name}: {count}; then: coulombus check --rig {shell(str(path))}"
            )


def _tell_trials(rig: Rig, text: str, *, err: bool) -> None:
    """Test the alternatives of a rehearsal's guesses, and print the check that detects each."""
    from coulombus.lab.guess_trials import NOBODY, tried

    trials = tried(rig, text)
    if not trials:
        return
    from rich.table import Table

    table = Table("guess", "if it is", "noticed by", "turns", "speed", "torque", title="Other readings of the guesses")
    for trial in trials:
        moved = (f"{trial.angle_rad:.2g} rad", f"{trial.speed_rad_s:.2g} rad/s", f"{trial.motor_Nm:.2g} Nm")
        table.add_row(trial.reading.key, trial.reading.meaning, trial.noticed_by, *moved)
    console = table_console(TABLE_COLUMNS)
    with console.capture() as drawn:
        console.print(table, markup=False)
    echo(drawn.get(), nl=False, err=err)
    unnoticed = sum(trial.noticed_by == NOBODY for trial in trials)
    if unnoticed:
        echo(f"readings that nothing notices: {unnoticed}; only a measurement on the device tells them apart", err=err)


def _answered(bus_name: str, drive_axis: int) -> dict[int, dict[tuple[int, int], int]]:
    """Identify the devices on a bus, print them, and return the object values of each node.

    A duplicate node id and an inconsistent identity are refused: the objects cannot be attributed to a device.
    """
    from coulombus.host.devices.scan import survey
    from coulombus.host.errors import AnswerUntrusted, DeviceMismatch
    from coulombus.wire.address import WITH_ADAPTERS, parse_address

    nodes = survey(parse_address(bus_name, WITH_ADAPTERS), drive_axis)
    for answers in nodes:
        if answers.twice:
            what_to_do = "take one off the bus, and give the other another id (coulombus lss)"
            raise DeviceMismatch(f"{answers.remark}; {what_to_do}")
        if answers.doubt:
            raise AnswerUntrusted(answers.remark)
        say(f"coulombus: {answers}")
    if not nodes:
        look = f"coulombus scan --bus {bus_name} tells of devices without a node id, of silent ones and of the wire"
        say(f"coulombus: no node on {bus_name} responds to SDO: {look}")
    return {answers.node_id: dict(answers.numbers) for answers in nodes}


def _acknowledgements(rig: Rig) -> Iterator[str]:
    """Yield the acknowledgements that the rig file needs before its devices are armed
    (`rigs.errors.Problem.accept`).
    """
    from coulombus.host.cycle.controller import Controller
    from coulombus.host.setup.device_plan import device_plans
    from coulombus.rigs.errors import RigError

    for axis in rig.axes:
        for mode in axis.mode:
            try:
                controller = Controller(axis, mode)
            except RigError:  # of this mode; `check` reports it
                continue
            for plan in device_plans(controller):
                yield from (problem.accept for problem in plan.problems if problem.accept)
