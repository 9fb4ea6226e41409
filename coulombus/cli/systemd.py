"""``coulombus systemd``: host, simulation and bridge as services."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import OutputDirectory
from coulombus.cli.options import BusOption, ModeOption, OverwriteOption, RigOption, option, with_options
from coulombus.cli.rig_options import check_mode, load
from coulombus.cli.tables import echo
from coulombus.system.exit import printed

__all__ = ["systemd"]


@click.command(epilog=EXIT_STATUS)
@with_options
def systemd(
    rig_name: RigOption,
    bus_name: BusOption,
    mode: ModeOption,
    user: Annotated[bool, option("For your own service manager (systemctl --user), not for the system's.")],
    bridge: Annotated[bool, option("Join a virtual bus with can0: with a bridge and that interface's files.")],
    folder: Annotated[
        Path,
        option(
            "-o",
            "--out",
            "Where the files are written.",
            type=OutputDirectory(make=False),
            default=Path("coulombus-systemd"),
            metavar="DIR",
        ),
    ],
    overwrite: OverwriteOption,
) -> None:
    """Write systemd units for host, simulation and bridge, and what belongs to them: user, limits, and
    for a CAN interface device rules and its set-up.

    Nothing is installed: INSTALL.txt says how. The host's unit is never restarted, as nothing
    re-arms by itself after a trip; its watchdog is fed only while the cycle goes on. A file that
    exists is left as it is without --overwrite.

    \b
    Examples:
      coulombus systemd --rig my-rig.toml --bus socketcan:can0 --mode hybrid -o units
      coulombus systemd --user
    """
    with errors():
        from coulombus.host.run.preflight import check_no_guess, check_no_rehearsal
        from coulombus.host.service.units import UnitSettings, files
        from coulombus.recording.output_file import check as check_output
        from coulombus.recording.output_file import new_file
        from coulombus.rigs.buses import one_bus
        from coulombus.rigs.rig import known_rigs

        rig = load(rig_name, ())
        check_mode(rig, rig_name, mode)
        if len(rig.channels) > 1:
            text = f"{rig_name}: a unit runs one bus, and the rig has the buses {', '.join(rig.channels)}"
            raise click.BadParameter(text, param_hint="--rig")
        on_bus, address = one_bus(rig, bus_name, None)
        check_no_rehearsal(rig, address)
        check_no_guess(rig, address)
        script = shutil.which("coulombus", path=str(Path(sys.prefix, "bin")))
        limits = [axis.limits for axis in on_bus.axes]
        service = UnitSettings(
            program=(script,) if script else (sys.executable, "-P", "-m", "coulombus"),
            rig=rig_name if rig_name in known_rigs() else str(Path(rig_name).absolute()),
            bus=str(address),
            mode=mode,
            bitrate_bit_s=on_bus.bus.bitrate_bit_s,
            ending_s=max(limit.safe_hold_s + limit.safe_ramp_s for limit in limits),
            user=user,
            bridge=bridge,
        )
        texts = {folder / name: text for name, text in files(service).items()}
        folder.mkdir(parents=True, exist_ok=True)
        for path in texts:  # all or none
            check_output(path, force=overwrite)
        for path, text in texts.items():
            with new_file(path, force=overwrite) as new:
                new.write_text(text)
        with printed():
            for path in texts:
                echo(str(path))
