"""Property tests draw the same examples in every run. Signals do what they do at a terminal, in a
background job, too.

Real-time tests are done again if the machine stood still when they failed.
"""

import gc
import os
import pty
import signal
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, settings

from standstill import LIMIT_S, Watchers
from tiny_bus import tiny_bus

settings.register_profile(  # how fast a busy machine draws is nothing that a test asks
    "coulombus", max_examples=50, derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("coulombus")

ROOMS = {path.name for path in (Path(__file__).resolve().parents[1] / "coulombus").iterdir() if path.is_symlink()}


class OneName:
    """A module has one name, as `coulombus.node.core`: as `node.core` it would be loaded a second
    time, with classes of its own.
    """

    @staticmethod
    def find_spec(name, path=None, target=None):
        if path is None and name in ROOMS:
            raise ImportError(f"import coulombus.{name} instead of {name}")


sys.meta_path.insert(0, OneName)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell starts what stands before an &
    signal.signal(signal.SIGINT, signal.default_int_handler)
for _number in (signal.SIGQUIT, signal.SIGHUP):  # as nohup starts what is to outlive its terminal
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)

watchers = pytest.StashKey[Watchers]()


@pytest.fixture
def short_path():
    """A directory for sockets, whose paths have at most 107 bytes: it is short, whatever TMPDIR is."""
    with TemporaryDirectory(prefix="c-", dir="/tmp") as directory:
        yield Path(directory)


@pytest.fixture
def private_sockets(short_path, monkeypatch):
    """The built-in buses of this test are its own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(short_path))


@pytest.fixture
def bus(private_sockets):
    with tiny_bus() as bus:
        yield bus


def pytest_ignore_collect(collection_path, config):
    """To read all files takes a quarter of a minute: who asks for real-time tests alone, or for thorough
    ones, need not wait for the others'.
    """
    marks = [word for word in config.option.markexpr.split(" and ") if word.isidentifier()]
    if not marks or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text()
    return None if all(mark in text for mark in marks) else True


@pytest.fixture(scope="module", autouse=True)
def frozen_memory():
    """What the tests before have loaded stays: the collector, which some code calls, need not look at it again."""
    gc.freeze()


def pytest_collection_modifyitems(session, items):
    """A real-time test that fails while the machine stood still is no evidence: it is done again,
    up to three times.
    """

    def stood_still():
        return session.stash[watchers].longest_s() > LIMIT_S

    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.flaky(reruns=3, condition=stood_still))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    if item.get_closest_marker("real_time"):
        stash = item.session.stash
        if watchers not in stash:
            stash[watchers] = Watchers()
        stash[watchers].longest_s()
    return (yield)


class AtOnce:
    """Writes a failure when it happens; the summary has it again."""

    def __init__(self, terminal):
        self.terminal = terminal

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.terminal.write_line(f"\nFAILED {report.nodeid} ({report.when})\n{report.longreprtext}")


def pytest_sessionstart(session):
    plugins = session.config.pluginmanager
    terminal = plugins.get_plugin("terminalreporter")
    if session.config.option.at_once and terminal is not None:
        plugins.register(AtOnce(terminal))


def pytest_terminal_summary(terminalreporter):
    """Tell what failed before it was done again."""
    for report in terminalreporter.getreports("rerun"):
        terminalreporter.write_line(f"AGAIN {report.nodeid}, the machine stood still: {report.longreprtext[-2000:]}")


def pytest_sessionfinish(session):
    if watchers in session.stash:
        session.stash[watchers].close()


def pytest_addoption(parser):
    parser.addoption("--at-once", action="store_true", help="write a failure when it happens, too")
    parser.addoption(
        "--every-fault", action="store_true", help="fault injection: many calls of each place in the code, not one"
    )


@pytest.fixture
def terminal(monkeypatch):
    """A pseudo-terminal as stdin; yield the end that a person types on."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as file:
        monkeypatch.setattr("sys.stdin", file)
        yield ours
    os.close(ours)
