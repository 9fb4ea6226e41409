"""What a service tells systemd: messages, and signs of life only while something goes on."""

from __future__ import annotations

import os
import socket

import pytest

from coulombus.system.sd_notify import Notifier


@pytest.fixture
def manager(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ear:
        ear.bind(str(tmp_path / "notify"))
        yield ear


def heard(ear):
    messages = []
    while True:
        try:
            messages.append(ear.recv(4096).decode())
        except BlockingIOError:
            return messages


def environment(manager, **more):
    return {"NOTIFY_SOCKET": manager.getsockname(), "PATH": "/bin", **more}


def test_messages_are_lines_and_the_children_inherit_nothing(manager):
    variables = environment(manager, WATCHDOG_USEC="5000000", WATCHDOG_PID=str(os.getpid()))
    notifier = Notifier(variables)
    assert variables == {"PATH": "/bin"}
    notifier.send(READY=1, STATUS="two\nlines")
    assert heard(manager) == ["READY=1\nSTATUS=two lines"]


def test_what_stands_still_gives_no_sign_of_life(manager):
    notifier = Notifier(environment(manager, WATCHDOG_USEC="1"))
    for progress in (1, 1, 1, 2, 2):
        notifier.alive(progress)
    assert heard(manager) == ["WATCHDOG=1"] * 2


def test_signs_of_life_come_no_oftener_than_the_watchdog_needs(manager):
    notifier = Notifier(environment(manager, WATCHDOG_USEC=str(3_600_000_000)))
    for progress in range(100):
        notifier.alive(progress)
    assert heard(manager) == ["WATCHDOG=1"]


@pytest.mark.parametrize(
    "variables",
    [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}],
)
def test_where_nobody_waits_for_a_sign_of_life_none_is_given(manager, variables):
    notifier = Notifier(environment(manager, **variables))
    notifier.alive(1)
    assert heard(manager) == []


@pytest.mark.parametrize("name", ["", "relative", "/proc/nonexistent/socket", "@", "@nobody-listens", "/" + "x" * 200])
def test_a_manager_that_is_not_there_is_no_error(name):
    notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "1"})
    notifier.send(READY=1)
    notifier.alive(1)


def test_a_manager_that_does_not_read_holds_nobody_up(manager):
    notifier = Notifier(environment(manager))
    for _ in range(10_000):
        notifier.send(STATUS="x" * 100)
    assert 0 < len(heard(manager)) < 10_000


def test_an_abstract_socket_is_reached():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as ear:
        ear.bind(f"\0coulombus-test-{os.getpid()}")
        Notifier({"NOTIFY_SOCKET": f"@coulombus-test-{os.getpid()}"}).send(READY=1)
        assert heard(ear) == ["READY=1"]
