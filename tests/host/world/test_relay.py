"""Messages of a WebSocket client, and the records that they become."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.host.world.model_parts import Model, Wall
from coulombus.host.world.protocol import Greeting, Kind, Named, Refusal, Welcome, head_of, read_refusal
from coulombus.host.world.records import MODEL, STATE, ModelParts
from coulombus.host.world.relay import MOST_STATES, MalformedMessage, Relay

NAMED = Named(0, 1, 0.0, 4.5, 3.5, "F_s_Nm")
WELCOME = Welcome(1, 1, 1, 1_000_000, 1, 1_000_000_000, 7)
HELLO = {"type": "hello", "states": True}


def state(number, **values):
    record = np.zeros(1, STATE)
    record["head"], record["sequence"], record["x_rad"] = head_of(Kind.STATE), number, 0.5 * number
    for name, value in values.items():
        record[name] = value
    return record.tobytes()


def opened(message=None):
    """Return a relay after the host's answer to HELLO."""
    relay = Relay()
    relay.translate(json.dumps(HELLO) if message is None else message)
    relay.receive(WELCOME.record() + NAMED.record())
    relay.batch()
    return relay


def model(relay, **fields):
    return np.frombuffer(relay.translate(json.dumps({"type": "model", **fields})), MODEL)[0]


def test_hello_becomes_the_record_and_the_answer_a_message():
    relay = Relay()
    assert relay.translate('{"type": "hello", "states": false, "key": "123456"}') == Greeting(0, "123456").record()
    relay.receive(WELCOME.record())
    assert not relay.is_pending
    relay.receive(NAMED.record()[:50])
    relay.receive(NAMED.record()[50:])
    (text,) = relay.batch()
    assert json.loads(text) == {"type": "welcome", **WELCOME._asdict(), "parameters": [NAMED._asdict()]}
    assert not relay.is_pending


def test_a_json_model_is_the_record_of_the_same_model():
    relay = opened()
    wall = {"x_rad": 0.25, "K_Nm_rad": 2.0, "B_Nms_rad": 0.05, "side": "below"}
    record = model(relay, wall=wall, law=0.5, life_s=0.2, parameters={"F_s_Nm": 1.5})
    expected = Model(wall=Wall(0.25, 2.0, 0.05, "below"), law=0.5, life_s=0.2, parameters={"F_s_Nm": 1.5}).record(
        {"F_s_Nm": 1}
    )
    expected["sequence"] = 1
    assert record == expected
    assert model(relay)["sequence"] == 2
    assert model(relay, sequence=9, t_ns=5, axis=1)[["sequence", "t_ns", "axis"]].tolist() == (9, 5, 1)
    assert model(relay)["sequence"] == 10


def test_all_parts_of_a_json_model_reach_the_record():
    profile = {"torque_Nm": [0.5, -0.5], "sample_s": 0.002, "number": 7}
    record = model(
        opened(), spring={"x_rad": 0.5, "K_Nm_rad": 3.0, "most_Nm": 1.0}, field={"Nms_rad": -0.1}, profile=profile
    )
    assert record["parts"] == ModelParts.SPRING | ModelParts.FIELD | ModelParts.PROFILE
    assert (record["spring_K_Nm_rad"], record["field_Nms_rad"], record["profile"]) == (3.0, -0.1, 7)
    assert (record["samples"], record["sample_ns"], record["sample"][:2].tolist()) == (2, 2_000_000, [0.5, -0.5])


def test_parts_with_vectors_are_those_of_the_plane():
    wall = {"point_m": [0.25, 0], "normal": [-2, 0], "K_N_m": 300}
    field = {"Ns_m": [[-1, 0], [0, -2]]}
    profile = {"force_N": [0.5], "direction": [0, 1], "number": 7}
    record = model(opened(), wall=wall, field=field, profile=profile)
    assert record["parts"] == ModelParts.WALL | ModelParts.FIELD | ModelParts.PROFILE | ModelParts.PLANE
    assert (record["plane_wall_point_m"].tolist(), record["plane_wall_normal"].tolist()) == ([0.25, 0.0], [-1.0, 0.0])
    assert record["plane_field_Ns_m"].tolist() == [-1.0, 0.0, 0.0, -2.0]
    assert (record["profile_direction"].tolist(), record["profile"]) == ([0.0, 1.0], 7)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ("{", "Expecting"),
        ("[]", "JSON object"),
        ('{"type": "hello"}', 'expected "type": "model"'),
        ('{"type": "model", "wal": {}}', "wal: expected one of"),
        ('{"type": "model", "wall": {}}', "missing"),
        ('{"type": "model", "wall": 5}', "wall: expected an object"),
        ('{"type": "model", "parameters": null}', "parameters: expected an object"),
        ('{"type": "model", "field": 0}', "field: expected an object"),
        ('{"type": "model", "profile": [1]}', "profile: expected an object"),
        ("[" * 8000, "nested too deeply"),
        ('{"type": "model", "wall": {"x_rad": NaN, "K_Nm_rad": 1}}', "NaN"),
        ('{"type": "model", "wall": {"x_rad": 1e999, "K_Nm_rad": 1}}', "finite"),
        ('{"type": "model", "wall": {"x_rad": 0, "K_Nm_rad": -1}}', "0 or more"),
        ('{"type": "model", "parameters": {"Z": 1}}', "no parameter"),
        ('{"type": "model", "parameters": [1]}', "expected an object"),
        ('{"type": "model", "axis": 0.5}', "whole numbers"),
        ('{"type": "model", "sequence": 99999999999999999999}', "whole numbers of 64 bits"),
        ('{"type": "model", "t_ns": -9223372036854775808}', "whole numbers of 64 bits"),
        ('{"type": "model", "sequence": -5}', "sequence is -5: expected a number above 0"),
        ('{"type": "model", "sequence": 4611686018427387904}', "sequence is 4611686018427387904: expected"),
        (b"\x02\x00\x50\x02", "mixed"),
    ],
)
def test_a_malformed_message_is_refused_and_the_next_one_is_taken(message, reason):
    relay = opened()
    with pytest.raises(MalformedMessage, match=f"malformed message 1: .*{reason}"):
        relay.translate(message)
    (text,) = relay.batch()
    answer = json.loads(text)
    assert (answer["type"], answer["sequence"], answer["again"]) == ("refused", 0, 0)
    assert reason in answer["reason"]
    assert relay.malformed == 1
    assert model(relay)["sequence"] == 1


def test_a_number_that_falls_back_does_not_make_the_next_models_fall_back():
    relay = opened()
    sequences = [model(relay, **fields)["sequence"] for fields in ({"sequence": 7}, {"sequence": 3}, {}, {})]
    assert sequences == [7, 3, 8, 9]


def test_binary_messages_are_whole_records_of_the_socket():
    relay = opened(Greeting().record())
    data = Model(wall=Wall(0.0, 2.0)).record({}).tobytes()
    assert relay.translate(data * 3) == data * 3
    for wrong in (data[:-1], data + b"\0", Greeting().record(), b"", b"\xff" * 776):
        with pytest.raises(MalformedMessage, match="whole MODEL records of 776 bytes"):
            relay.translate(wrong)
    refusals = [read_refusal(record) for record in relay.batch()]
    assert [refusal.sequence for refusal in refusals] == [0] * 5
    assert refusals[-1].reason.startswith("malformed message 5: ")
    relay.receive(state(1) + Refusal(4, 0, "another program has control").record() + state(2))
    refusal, states = relay.batch()
    assert read_refusal(refusal).reason == "another program has control"
    assert states == state(1) + state(2)


def test_states_are_a_column_for_each_field_and_null_for_no_number():
    relay = opened()
    relay.receive(state(1) + state(2, handle_Nm=np.nan, lost=3))
    (text,) = relay.batch()
    states = json.loads(text)
    assert (states["type"], states["sequence"], states["x_rad"]) == ("states", [1, 2], [0.5, 1.0])
    assert (states["handle_Nm"], states["lost"]) == ([0.0, None], [0, 3])


def test_a_slow_client_loses_the_oldest_states_and_is_told_their_number():
    relay = opened(Greeting().record())
    for number in range(1, MOST_STATES + 6):
        relay.receive(state(number, lost=2))
    states = np.frombuffer(relay.batch()[0], STATE)
    assert (len(states), states["sequence"][0], states["sequence"][-1]) == (MOST_STATES, 6, MOST_STATES + 5)
    assert set(states["lost"].tolist()) == {5 + 2}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["type", "wall", "x_rad", "K_Nm_rad", "profile", "torque_Nm", "axis", "law", "parameters"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=8,
)


@settings(derandomize=True, max_examples=120, deadline=None)
@given(JSON)
def test_any_json_is_a_record_or_a_malformed_message(fields):
    relay = opened()
    if isinstance(fields, dict):
        fields = {**fields, "type": "model"}
    try:
        data = relay.translate(json.dumps(fields))
    except MalformedMessage:
        assert relay.malformed == 1
    else:
        assert len(data) == MODEL.itemsize
