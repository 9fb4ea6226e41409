"""pytest's plugin: a virtual bus with simulated nodes for each test, and its log in the failure report.

pytest loads this module in every project of the environment, so that the fixtures alone import the
bus.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from coulombus.kernels.compile_notice import on_compiling

if TYPE_CHECKING:
    from coulombus.lab.bus_log import BusLog, LoggedNetwork
    from coulombus.lab.served_bus import BusNode, ServedBus

_LOGS = pytest.StashKey[dict[str, "BusLog"]]()


@pytest.fixture(scope="session")
def _compile_notice(pytestconfig: pytest.Config) -> None:
    """Report a compilation, which takes long."""

    def say() -> None:
        terminal = pytestconfig.pluginmanager.get_plugin("terminalreporter")
        capture = pytestconfig.pluginmanager.get_plugin("capturemanager")
        if terminal is not None and capture is not None:
            with capture.global_and_fixture_disabled():
                terminal.write_line("\ncoulombus: compiling the bus, once on this machine, a minute or two ...")

    on_compiling(say)


@pytest.fixture(scope="session")
def _live(_compile_notice: None) -> None:
    """Remove the sockets of killed processes; an error on a system without live buses."""
    from coulombus.lab.served_bus import remove_stale

    remove_stale()


@pytest.fixture
def _bus_end() -> Iterator[ExitStack]:
    """Things to close after the test, also after a failure or an interrupt."""
    with ExitStack() as stack:
        yield stack


def _close_after_test(request: pytest.FixtureRequest, stack: ExitStack, bus: ServedBus) -> ServedBus:
    stack.callback(bus.close)
    request.node.stash.setdefault(_LOGS, {})[str(bus.address)] = bus.log
    return bus


@pytest.fixture
def can_bus(request: pytest.FixtureRequest, _live: None, _bus_end: ExitStack) -> ServedBus:
    """Return a virtual CAN bus of this test: `can_bus.channel` is its name for python-can."""
    from coulombus.lab.served_bus import empty_bus

    return _close_after_test(request, _bus_end, empty_bus())


@pytest.fixture
def canopen_node(request: pytest.FixtureRequest, can_bus: ServedBus) -> Callable[..., BusNode]:
    """Return a function that adds a node to `can_bus`: ``canopen_node("drive.eds", node_id=5, kind="drive")``."""

    def add(eds: str | Path, node_id: int | None = None, kind: str | None = None) -> BusNode:
        return can_bus.add(_beside(request, eds), node_id, kind)

    return add


@pytest.fixture
def rig(request: pytest.FixtureRequest, _live: None, _bus_end: ExitStack) -> Callable[..., ServedBus]:
    """Return a function that serves a rig on a bus of its own: ``rig("bench")``."""
    from coulombus.lab.served_bus import rig_bus

    def serve(name: str, seed: int = 0) -> ServedBus:
        path = _beside(request, name)
        return _close_after_test(request, _bus_end, rig_bus(str(path) if path.exists() else name, seed))

    return serve


@pytest.fixture
def faults(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Return a function that injects the faults of a TOML text or file, on `can_bus` or on another bus."""

    def inject(text: str | Path, bus: ServedBus | LoggedNetwork | None = None, seed: int = 0) -> None:
        from coulombus.sim_bus.faults.fault_file import faults_of, read_faults

        plan = read_faults(_beside(request, text)) if isinstance(text, Path) else faults_of(text, "faults")
        (bus or request.getfixturevalue("can_bus")).inject(plan, seed)

    return inject


@pytest.fixture
def virtual_network(request: pytest.FixtureRequest, _compile_notice: None) -> LoggedNetwork:
    """Return a network in virtual time, which the test lets pass; its `log` is that of `can_bus`."""
    from coulombus.lab.bus_log import LoggedNetwork

    network = LoggedNetwork()
    request.node.stash.setdefault(_LOGS, {})["in virtual time"] = network.log
    return network


def _beside(request: pytest.FixtureRequest, name: str | Path) -> Path:
    """Return a path that is relative to the test's file, or else to the working directory."""
    near = request.path.parent / name
    return near if near.exists() else Path(name)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the log of each bus to the report of a failure."""
    report = yield
    if report.failed:
        for name, log in item.stash.get(_LOGS, {}).items():
            report.sections.append((f"CAN bus {name}", log.report()))
    return report
