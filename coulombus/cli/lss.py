"""``coulombus lss``: give devices node ids and bit rates (CiA 305)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.device_options import BesideOption, DevicesBusOption, EdsFolderOption, LiveLine, open_link
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import BIT_RATE, SECONDS
from coulombus.cli.options import JsonOption, option, with_options
from coulombus.cli.tables import echo
from coulombus.system.exit import verdict

if TYPE_CHECKING:
    from coulombus.host.devices.lss import Identity
else:
    Identity = Any  # of a field, whose annotation is read for --help: without importing the module

__all__ = ["lss"]


class IdentityType(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """VENDOR:PRODUCT:REVISION:SERIAL in hexadecimal."""

    name = "identity"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Identity:
        """Return the identity; BadParameter has the correct form."""
        from coulombus.host.devices.lss import Identity

        if isinstance(value, Identity):
            return value
        try:
            return Identity.parse(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


@dataclass(frozen=True)
class Assignment:
    """New settings and their devices, from the options."""

    node_id: Annotated[
        int | None, option("--set-id", "Give the device this node id.", type=click.IntRange(1, 127), metavar="N")
    ]
    everybody: Annotated[bool, option("--all", "Number all devices without a node id: N, N + 1, and so on.")]
    identity: Annotated[
        Identity | None,
        option(
            "--device",
            "The device of this identity (1018h, hexadecimal), with a node id or without.",
            type=IdentityType(),
            metavar="V:P:R:S",
        ),
    ]
    bitrate: Annotated[
        int | None, option("Give the device this bit rate; needs --store.", type=BIT_RATE, metavar="BIT/S")
    ]
    store: Annotated[bool, option("Let the device store it.")]

    @property
    def changes(self) -> bool:
        """Whether any setting is changed."""
        return self.node_id is not None or self.bitrate is not None or self.store

    def check(self) -> None:
        """Refuse incompatible options.

        Raises
        ------
        click.UsageError
            The text names the options to add or omit.
        """
        from coulombus.host.devices.lss import rate_index

        if self.everybody and (self.identity is not None or self.node_id is None):
            raise click.UsageError("--all goes with --set-id, and not with --device")
        if self.bitrate is not None and not self.store:
            raise click.UsageError("a bit rate counts from the next power-on: add --store, or the device forgets it")
        if self.bitrate is not None:
            try:
                rate_index(self.bitrate)
            except ValueError as error:
                raise click.BadParameter(str(error), param_hint="--bitrate") from None


@click.command(epilog=EXIT_STATUS)
@with_options
def lss(
    bus_name: DevicesBusOption,
    eds_folder: EdsFolderOption,
    assignment: Assignment,
    timeout_s: Annotated[
        float | None,
        option(
            "--timeout",
            "How long an answer may take. [default: 1; to --store 10; a boot-up 5]",
            type=SECONDS,
            metavar="S",
        ),
    ],
    beside: BesideOption,
    as_json: JsonOption,
) -> None:
    """List the devices without a node id, or give devices node ids and bit rates (LSS).

    Without --set-id, --bitrate and --store nothing is changed. A device without a node id boots at
    once with the one that it gets; one that has an id is reset (communication only) to take the
    new one. A bit rate counts from the next power-on. An id that another node has is refused (3).
    Ends with 5 when a device does not answer, or does not boot with an id that it has not stored.

    \b
    Examples:
      coulombus lss --bus socketcan:can0
      coulombus lss --bus socketcan:can0 --set-id 5 --store
      coulombus lss --bus socketcan:can0 --set-id 10 --all --store
      coulombus lss --bus socketcan:can0 --device 4C0:402:10000:7 --set-id 6
      coulombus lss --bus socketcan:can0 --device 4C0:402:10000:7 --bitrate 1000000 --store
    """
    with errors():
        from coulombus.eds.eds_folder import fitting, read_folder
        from coulombus.eds.own_devices import packaged
        from coulombus.host.devices.lss import LssMaster
        from coulombus.host.devices.numbering import BOOT_S, AssignedId, check_free, give, only

        assignment.check()
        files = [*(read_folder(eds_folder)[0] if eds_folder is not None else ()), *packaged()]
        numbered: list[AssignedId] = []
        with LiveLine() as show, open_link(bus_name, beside=beside) as link, LssMaster(link, timeout_s) as master:
            identities = (
                [] if assignment.identity else master.unconfigured(lambda count: show(f"fastscan: {count} found"))
            )
            if assignment.changes:
                devices = identities if assignment.everybody else [assignment.identity or only(identities)]
                ids = [None if assignment.node_id is None else assignment.node_id + k for k in range(len(devices))]
                if assignment.node_id is not None:
                    check_free(link, [node_id for node_id in ids if node_id is not None], show)
                for identity, new in zip(devices, ids, strict=True):
                    show(f"setting {identity}")
                    numbered.append(
                        give(
                            master,
                            link,
                            identity,
                            new,
                            bit_s=assignment.bitrate,
                            store=assignment.store,
                            boot_s=timeout_s or BOOT_S,
                        )
                    )
        status = 0 if all(number.booted is not False or number.stored for number in numbered) else 5
        with verdict(status):
            rows = [
                {
                    **identity._asdict(),
                    "eds": None if (file := fitting(files, identity[:2], identity.revision)) is None else file.path,
                }
                for identity in identities
            ]
            if as_json:
                print_json({"unconfigured": rows, "set": [number.as_dict() for number in numbered]})
            elif assignment.changes:
                for done in numbered:
                    echo(str(done))
            else:
                for identity, row in zip(identities, rows, strict=True):
                    echo(f"{identity}  {Path(row['eds']).name if row['eds'] else 'no EDS file'}")
                count = len(identities) or "no"
                echo(f"{count} device{'s' * (len(identities) != 1)} without a node id on {bus_name}")
