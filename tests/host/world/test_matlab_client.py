"""The client for MATLAB: its messages have the gateway's names. There is no MATLAB here that could run it."""

import json
import re
from dataclasses import fields

import numpy as np
import pytest

from coulombus.host.world.model_parts import Wall
from coulombus.host.world.protocol import Greeting, Kind, Named, Refusal, Welcome, head_of
from coulombus.host.world.records import MODEL, STATE
from coulombus.host.world.relay import Relay
from places import ROOT

SOURCE = (ROOT / "examples/worlds/coulombus_world.m").read_text()
VALUES = {"true": True, "wall": {"x_rad": 0.0, "K_Nm_rad": 2.0, "B_Nms_rad": 0.05}}


def said():
    """Return the messages that the client sends, as objects."""
    messages = []
    for arguments in re.findall(r"send_json\(socket, struct\((.*?)\)\)", SOURCE):
        words = [word.strip() for word in arguments.split(",")]
        values = [VALUES[word] if word in VALUES else json.loads(word) for word in words]
        messages.append(dict(zip(values[::2], values[1::2], strict=True)))
    return messages


def test_the_gateway_accepts_what_the_client_says():
    hello, model = said()
    relay = Relay()
    assert relay.translate(json.dumps(hello)) == Greeting().record()
    record = np.frombuffer(relay.translate(json.dumps(model)), MODEL)[0]
    assert (record["wall_K_Nm_rad"], record["law"], record["life_ns"]) == (2.0, 0.0, 200_000_000)
    names = re.search(r"wall = struct\((.*)\);", SOURCE)[1].split(",")[::2]
    assert {json.loads(name) for name in names} <= {item.name for item in fields(Wall)}


@pytest.mark.parametrize(
    ("kind", "known"),
    [("welcome", {*Welcome._fields, "parameters"}), ("refused", set(Refusal._fields)), ("states", set(STATE.names))],
)
def test_the_client_reads_fields_that_the_gateway_sends(kind, known):
    case = re.search(rf'case "{kind}"(.*?)(?=case "|\n        end\n)', SOURCE, re.DOTALL)[1]
    read = set(re.findall(r"message\.(\w+)", case))
    assert read
    assert read <= known


def test_the_gateway_sends_these_kinds_and_no_other():
    relay = Relay()
    relay.translate('{"type": "hello"}')
    relay.receive(Welcome(1, 1, 1, 1_000_000, 1, 10**9, 7).record() + Named(0, 0, 0.0, 4.5, 3.5, "F_s_Nm").record())
    state = np.zeros(1, STATE)
    state["head"] = head_of(Kind.STATE)
    relay.receive(Refusal(1, 0, "no").record() + state.tobytes())
    kinds = [json.loads(text)["type"] for text in relay.batch()]
    assert kinds == re.findall(r'case "(\w+)"', SOURCE)
