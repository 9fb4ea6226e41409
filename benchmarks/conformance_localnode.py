"""The conformance run against canopen's LocalNode, on a bus of `coulombus emulate`, beside our own
nodes: a table of what it fails.

    coulombus emulate --bus coulombus:compare &
    python -m benchmarks.conformance_localnode coulombus:compare

The LocalNode has our EDS and another node id, and is used as its documentation does:
`nmt.send_command(0)` after it was added, so that its boot-up goes out, and nothing else.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import can
import canopen

from coulombus.conformance.catalogue import Case
from coulombus.conformance.report import markdown, summary
from coulombus.conformance.runner import Report, check_before, run, select
from coulombus.conformance.tester.unit import Timing, Unit
from coulombus.eds.reader import read_eds
from coulombus.wire.address import parse_address
from coulombus.wire.bus_link import BusLink

ROOT = Path(__file__).resolve().parent.parent
NODE_ID = 17


def compare(bus: str, eds: Path) -> Report:
    """Return what the LocalNode does with our EDS."""
    address = parse_address(bus)
    network = canopen.Network(bus=can.Bus(interface=address.kind, channel=address.name))
    network.connect()
    try:
        local = canopen.LocalNode(NODE_ID, str(eds))
        network.add_node(local)
        local.sdo[0x1018][4].raw = NODE_ID  # the simulated node with the same EDS has serial number 1, and LSS
        local.nmt.send_command(0)
        with BusLink(address) as link:
            unit = Unit(link, read_eds(eds), NODE_ID, Timing.from_timeout(0.3))
            check_before(unit, force=True)
            report = run(unit, select(()), lambda n, case: _show(n, case))
        if report.ended_by is not None:
            raise report.ended_by
        return report
    finally:
        network.disconnect()


def _show(n: int, case: Case) -> None:
    print(f"\r{n:4d} {case.id:6s} {case.name[:60]:60s}", end="", file=sys.stderr, flush=True)


def main() -> None:
    bus = sys.argv[1] if len(sys.argv) > 1 else "coulombus:compare"
    for name in ("motor", "mr_brake"):
        report = compare(bus, ROOT / "eds" / f"{name}.eds")
        print(f"\ncanopen {version('canopen')}, LocalNode with {name}.eds: {summary(report)}\n")
        if len(sys.argv) > 2:
            Path(sys.argv[2], f"localnode_{name}.md").write_text(markdown(report))
        print("| case | | reason |\n|---|---|---|")
        for one in report.outcomes:
            if one.result == "fail":
                print(f"| {one.case.id} | {one.case.name} | {one.reason} |")


if __name__ == "__main__":
    main()
