"""The marks that a rig file still has."""

from __future__ import annotations

import pytest

from coulombus.rigs.draft.marks import guesses

TEXT = """# CHECK: the file itself
# goes on

[host]
# CHECK: one thing
# and its second line
# CHECK: another thing
node_id = 127  # CHECK: no mark

# not a guess
[motor]
# CHECK: a torque
rated_torque_Nm = 0.2

# CHECK: a list
[[motor.sdo]]
index = 1

[axis.left.mechanics]
# CHECK: a sense
motor_polarity = 1
# CHECK: at the end"""


def test_each_mark_has_its_key_its_line_and_its_whole_text():
    assert [(guess.line, guess.key, guess.text) for guess in guesses(TEXT)] == [
        (3, "", "the file itself goes on"),
        (8, "host.node_id", "one thing and its second line"),
        (8, "host.node_id", "another thing"),
        (13, "motor.rated_torque_Nm", "a torque"),
        (16, "motor.sdo", "a list"),
        (21, "axis.left.mechanics.motor_polarity", "a sense"),
        (23, "", "at the end"),
    ]


def test_what_moves_the_hand():
    assert [guess.key for guess in guesses(TEXT) if guess.moves_hand] == [
        "motor.rated_torque_Nm",
        "motor.sdo",
        "axis.left.mechanics.motor_polarity",
    ]


@pytest.mark.parametrize("key", ["role.torque_setpoint.scale_Nm", "role.position.object"])
def test_roles_of_the_motor_move_the_hand(key):
    section, _, name = key.rpartition(".")
    (guess,) = guesses(f"[{section}]\n# CHECK: x\n{name} = 1\n")
    assert guess.moves_hand
