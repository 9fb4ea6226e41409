"""Devices of any maker on the virtual rig: each shows and takes the plant's quantities by the rig
file's roles.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401, IO404
from coulombus.node.kinds import GENERIC, PROFILES
from coulombus.rigs.rig import load_rig_text
from coulombus.sim_bus.faults.injection import stations_of
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.coupling import BrakeOutput, Quantity, brake_torque, show
from coulombus.sim_bus.rig.records import PlantRecord, RigAxis
from foreign_eds import BRAKE, I16, I32, MOTOR, U8, U16, another, edited, geared, with_array, with_variable, without
from node_bench import MS
from places import RIGS

BENCH = (RIGS / "bench.toml").read_text()
FOREIGN_MOTOR, FOREIGN_BRAKE = "motor.vendor_id=0x99", "brake.vendor_id=0x99"
RATIO = 9.587
COUNTS_RAD = 8192 * RATIO / (2 * math.pi)


def sensor(name, node_id, eds="mr_brake.eds"):
    return (
        f'\n[sensor.{name}]\nnode_id = {node_id}\neds = "{eds}"\nvendor_id = 0x99\nproduct_code = 0x404\n'
        "heartbeat_s = 0.05\nheartbeat_timeout_s = 0.15\n"
    )


def role(name, **keys):
    lines = (
        f"{key} = {value if isinstance(value, (int, float, list)) else repr(value)}" for key, value in keys.items()
    )
    return f"\n[role.{name}]\n" + "\n".join(lines) + "\n"


def world_of(motor=MOTOR, brake=BRAKE, *overrides, text="", **others):
    rig = load_rig_text(BENCH + text, "r.toml", {"motor.eds": motor, "mr_brake.eds": brake, **others}, overrides)
    world = VirtualRig(rig, "hybrid")
    world.power_on()
    world.wait_ns(2 * MS)
    return world


def kinds(world):
    return [PROFILES[int(device.record["kind"])] for device in world.devices]


def write(world, node_id, index, subindex, value, size):
    """Write an object by SDO."""
    data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
    world.send(0x600 + node_id, bytes((0x23 | 4 - size << 2, index & 0xFF, index >> 8, subindex)) + data)
    world.wait_ns(MS)


def look(world):
    """Let a SYNC pass, on which the devices look at the rig."""
    world.send(0x000, b"\1\0")
    world.wait_ns(MS)
    world.send(0x080, b"")
    world.wait_ns(MS)


def enable(world, node_id, mode):
    world.send(0x000, b"\1\0")
    write(world, node_id, 0x6060, 0, mode, 1)
    for controlword in (6, 7, 15):
        write(world, node_id, 0x6040, 0, controlword, 2)


def commanded(world):
    return float(world.plant[0]["brake_Nm"])


# our own


def test_our_own_two_devices_are_coupled_as_they_always_were():
    world = world_of()
    assert kinds(world) == [DRIVE402, BRAKE404]
    assert (world.axes[0]["foreign"], world.axes[0]["shown_count"], world.axes[0]["brake_output"]) == (0, 0, 0)
    assert world.opened == ()
    assert world.rows == {"motor": 0, "brake": 1}


# the motor


def test_the_drive_feels_the_set_point_of_its_makers_own_mode():
    motor = with_variable(edited(another(MOTOR), "6072", DefaultValue=1000), "2030", I16, 0)
    text = role("torque_setpoint", object="2030", scale_Nm=0.0001)
    world = world_of(motor, BRAKE, FOREIGN_MOTOR, "motor.mode=-3", text=text)
    enable(world, 1, -3)
    write(world, 1, 0x2030, 0, -150, 2)
    pm, Nm_pm = float(world.plant[0]["motor_pm"]), float(world.plant[0]["motor_Nm_pm"])
    assert pm * Nm_pm == pytest.approx(-150 * 0.0001 * RATIO)


def test_a_scale_of_the_rig_file_is_that_of_the_drives_per_mille():
    text = role("torque_setpoint", object="6071", scale_Nm=0.0005)
    world = world_of(MOTOR, BRAKE, "plant.motor_polarity=-1", "mechanics.motor_polarity=-1", text=text)
    assert float(world.plant[0]["motor_Nm_pm"]) == pytest.approx(-0.0005 * RATIO)
    assert world.axes[0]["foreign"] == 0
    world = world_of(MOTOR, BRAKE, "plant.motor_rated_torque_Nm=0.09", text=text)  # half of what is believed
    assert float(world.plant[0]["motor_Nm_pm"]) == pytest.approx(0.00025 * RATIO)


def test_torque_and_position_are_shown_in_the_width_of_their_roles():
    motor = with_variable(with_variable(another(MOTOR), "2041", I32, 0, "ro"), "2042", U16, 0, "ro")
    text = role("torque", object="2041", scale_Nm=1e-6) + role("position", object="2042", scale_rad=0.001)
    world = world_of(
        motor, BRAKE, FOREIGN_MOTOR, "plant.encoder_polarity=-1", "mechanics.encoder_polarity=-1", text=text
    )
    world.plant[0]["x"], world.plant[0]["coulomb"] = 1.2345, 100.0
    look(world)
    assert world.motor[0x2042, 0] == 0x10000 - 1234  # -1234.5 counts, the half upwards
    assert world.motor[0x6064, 0] == math.floor(-1.2345 * COUNTS_RAD + 0.5)
    world.plant[0]["motor"], world.plant[0]["motor_decay"] = 0.5, 1.0
    look(world)
    assert world.motor[0x2041, 0] == pytest.approx(0.5 / RATIO * 1e6, abs=1)


@pytest.mark.parametrize("counts_rev", [360, 8192])
def test_another_makers_drive_counts_as_its_own_objects_say(counts_rev):
    same = (f"motor.encoder_counts_rev={counts_rev}", f"plant.encoder_counts_rev={counts_rev}")
    world = world_of(geared(another(MOTOR)), BRAKE, FOREIGN_MOTOR, *same)
    world.plant[0]["x"], world.plant[0]["coulomb"] = -1.5, 100.0
    look(world)
    assert world.motor[0x6064, 0] == math.floor(-1.5 * 360 * RATIO / (2 * math.pi) + 0.5)


def test_a_plant_with_another_encoder_on_purpose_overrides_the_file():
    world = world_of(geared(another(MOTOR)), BRAKE, FOREIGN_MOTOR, "plant.encoder_counts_rev=4096")
    world.plant[0]["x"], world.plant[0]["coulomb"] = -1.5, 100.0
    look(world)
    assert world.motor[0x6064, 0] == math.floor(-1.5 * 4096 * RATIO / (2 * math.pi) + 0.5)


@pytest.mark.parametrize(("written", "sense"), [(0xC0, 1), (0x00, -1)])
def test_a_polarity_that_bring_up_writes_turns_the_position(written, sense):
    motor = with_variable(another(MOTOR), "607E", U8, "0xC0", "rw")
    row = f'\n[[motor.sdo]]\nindex = 0x607E\nsub = 0\ntype = "UNSIGNED8"\nvalue = {written}\n'
    world = world_of(motor, BRAKE, FOREIGN_MOTOR, text=row)
    world.plant[0]["x"], world.plant[0]["coulomb"] = 0.7, 100.0
    look(world)
    assert world.motor[0x6064, 0] == math.floor(sense * 0.7 * COUNTS_RAD + 0.5)


def test_a_torque_polarity_that_bring_up_writes_turns_the_torque():
    motor = with_variable(another(MOTOR), "607E", U8, 0, "rw")
    row = '\n[[motor.sdo]]\nindex = 0x607E\nsub = 0\ntype = "UNSIGNED8"\nvalue = 0x20\n'
    assert float(world_of(motor, BRAKE, FOREIGN_MOTOR, text=row).plant[0]["motor_Nm_pm"]) < 0.0


def test_a_file_that_tells_no_encoder_is_served_with_the_plants():
    motor = edited(another(MOTOR), "608Fsub1", DefaultValue="")
    world = world_of(motor, BRAKE, FOREIGN_MOTOR)
    assert world.motor[0x608F, 1] == 8192
    assert any("608Fh:01 is without a default" in text for text in world.opened)


def test_an_encoder_on_a_node_of_its_own_shows_the_position():
    encoder = with_variable(without(another(MOTOR), "60"), "6004", I32, 0, "ro")
    text = sensor("encoder", 7, "e.eds") + role("position", node="encoder", object="6004", scale_rad=0.0001)
    world = world_of(MOTOR, BRAKE, text=text, **{"e.eds": encoder})
    assert kinds(world) == [DRIVE402, BRAKE404, GENERIC]
    world.plant[0]["x"], world.plant[0]["coulomb"] = -0.3, 100.0
    look(world)
    assert world.devices[2][0x6004, 0] == -3000


# the brake


def test_a_cia_404_brake_in_raw_counts_and_its_table():
    table = [[0, 0.0], [1000, 1.0], [4000, 5.0]]
    world = world_of(MOTOR, another(BRAKE), FOREIGN_BRAKE, text=role("brake_setpoint", object="7300:1", table=table))
    assert kinds(world) == [DRIVE402, IO404]
    for raw, torque in ((0, 0.0), (500, 0.5), (2500, 3.0), (5000, 5.0)):
        write(world, 2, 0x7300, 1, raw, 2)
        assert commanded(world) == pytest.approx(torque)
    world.send(0x000, b"\x81\x02")  # reset node
    world.wait_ns(MS)
    assert commanded(world) == 0.0


def test_a_cia_404_brake_whose_file_tells_its_scale():
    world = world_of(MOTOR, another(BRAKE), FOREIGN_BRAKE)
    write(world, 2, 0x7300, 1, 3000, 2)
    assert commanded(world) == pytest.approx(3000 * 10.0 ** -world.brake.dictionary.number(0x6302, 1))


def test_our_own_brake_with_a_table_of_the_rig_file():
    table = [[0, 0.0], [2000, 3.0], [5000, 4.0]]
    world = world_of(text=role("brake_setpoint", object="7300:1", table=table))
    assert world.axes[0]["brake_output"] == BrakeOutput.DRIVER
    write(world, 2, 0x7300, 1, 1000, 2)
    assert commanded(world) == pytest.approx(1.5)


def io_brake():
    text = edited(another(BRAKE), "1000", DefaultValue="0x000F0191")
    return with_array(without(text, "73", "71", "63"), "6411", I16, 2)


def test_a_cia_401_output_brakes():
    text = role("brake_setpoint", object="6411:2", scale_Nm=0.0005)
    text += "".join(role(name, object="none") for name in ("handle_torque", "coil_current", "coil_temperature"))
    world = world_of(MOTOR, io_brake(), FOREIGN_BRAKE, text=text)
    assert kinds(world) == [DRIVE402, IO401]
    write(world, 2, 0x6411, 2, 6000, 2)
    assert commanded(world) == pytest.approx(3.0)
    write(world, 2, 0x6411, 1, 9000, 2)
    assert commanded(world) == pytest.approx(3.0)


@pytest.mark.parametrize("index", [0x6071, 0x2030])
def test_a_cia_402_drive_feeds_the_brakes_coil(index):
    brake = with_variable(edited(another(MOTOR), "6072", DefaultValue=1000), "2030", I16, 0)
    text = role("brake_setpoint", object=f"{index:04X}", table=[[0, 0.0], [800, 4.0]])
    text += role("coil_current", node="brake", object="6078", scale_A=0.001)
    mode = 10 if index == 0x6071 else -3
    options = (FOREIGN_BRAKE, "brake.product_code=0x402", f"brake.mode={mode}", "plant.brake_coil_lag_s=0")
    world = world_of(MOTOR, brake, *options, text=text)
    assert kinds(world) == [DRIVE402, DRIVE402]
    write(world, 2, index, 0, 400, 2)
    assert commanded(world) == 0.0  # not enabled
    enable(world, 2, mode)
    write(world, 2, index, 0, 400, 2)
    assert commanded(world) == pytest.approx(2.0)
    look(world)
    assert world.brake[0x6078, 0] == round(2.0 * float(world.plant[0]["coil_A_Nm"]) * 1000)
    write(world, 2, 0x6040, 0, 0, 2)
    assert commanded(world) == 0.0


# sensors


def test_sensors_on_nodes_of_their_own_and_five_nodes_on_one_axis():
    module = with_array(edited(another(BRAKE), "1000", DefaultValue="0x00040191"), "6401", I16, 4, "ro")
    module = without(module, "71", "73", "63")
    text = sensor("cell", 3) + sensor("coil", 4, "io.eds") + sensor("spare", 5, "io.eds")
    text += role("handle_torque", node="cell", object="7130:2", scale_Nm=0.002, offset_Nm=0.5)
    text += role("coil_current", node="coil", object="6401:3", scale_A=0.0001)
    text += role("coil_temperature", node="spare", object="6401:1", scale_degC=0.1, offset_degC=-40.0)
    options = ("plant.transducer_polarity=-1", "mechanics.transducer_polarity=-1", "plant.transducer_noise_Nm=0")
    world = world_of(
        MOTOR,
        BRAKE,
        *options,
        "plant.temperature_degC=30",
        text=text,
        **{"io.eds": module, "mr_brake.eds": another(BRAKE)},
    )
    assert kinds(world)[2:] == [IO404, IO401, IO401]
    assert world.rows == {"motor": 0, "brake": 1, "cell": 2, "coil": 3, "spare": 4}
    world._f_h[:] = 1.5
    world.plant[0]["coulomb"] = 100.0
    look(world)
    operator_Nm = float(world.plant[0]["f_operator"])
    assert operator_Nm == pytest.approx(1.5, abs=0.2)
    assert world.devices[2][0x7130, 2] == pytest.approx((-operator_Nm - 0.5) / 0.002, abs=20)
    assert world.devices[4][0x6401, 1] == 700
    world.plant[0]["coil"] = 2.0
    world.plant[0]["coil_decay"] = 1.0
    look(world)
    assert world.devices[3][0x6401, 3] == round(2.0 * float(world.plant[0]["coil_A_Nm"]) / 0.0001)


def test_a_fault_file_may_name_a_sensor():
    module = another(BRAKE)
    world = world_of(MOTOR, module, FOREIGN_BRAKE, text=sensor("cell", 3) + role("handle_torque", node="cell"))
    names, node_ids = stations_of(world)
    assert (names["cell"], node_ids[3]) == (2, 2)


def test_axes_may_share_a_sensor_node_only_by_id():
    two = (RIGS / "two_axes.toml").read_text()
    rig = load_rig_text(two, "r.toml", {"motor.eds": MOTOR, "mr_brake.eds": BRAKE})
    world = VirtualRig(rig, "hybrid")
    assert [name.rpartition(".")[2] for name in world.rows] == ["motor", "brake", "motor", "brake"]
    assert list(world.rows.values()) == [0, 1, 2, 3]


# the arithmetic


def coupled(**fields):
    axis = new_records(RigAxis)
    for name, value in fields.items():
        axis[0][name] = value
    return axis


@pytest.mark.parametrize(
    ("quantity", "offset", "bounds", "count"),
    [
        (Quantity.POSITION, 0.0, (-(1 << 31), (1 << 31) - 1), -2500),
        (Quantity.POSITION, 0.0, (-128, 127), 60),  # -2500 mod 256
        (Quantity.POSITION, 0.0, (0, 65535), 65536 - 2500),
        (Quantity.VELOCITY, 0.0, (-32768, 32767), 32767),
        (Quantity.TORQUE, 0.0, (-32768, 32767), -1500),
        (Quantity.TORQUE, 0.0, (0, 65535), 0),
        (Quantity.HANDLE, 1.0, (-32768, 32767), 250),
        (Quantity.CURRENT, 0.0, (-32768, 32767), 700),
        (Quantity.TEMPERATURE, -10.0, (-32768, 32767), 32000),
    ],
)
def test_what_an_object_shows(quantity, offset, bounds, count):
    plant, axis = new_records(PlantRecord), coupled(shown_count=1)
    nodes = np.zeros(2, [("values", np.int64, (8,))]).view(np.recarray)
    plant[0]["x"], plant[0]["v"], plant[0]["motor"], plant[0]["temperature"] = -2.5, 40.0, -1.5, 22.0
    axis[0]["shown"][0] = (1, 3, quantity, 1000.0, offset, *bounds)
    show.py_func(axis[0], plant[0], nodes, 1.25, 0.7) if hasattr(show, "py_func") else show(
        axis[0], plant[0], nodes, 1.25, 0.7
    )
    assert nodes[1]["values"][3] == count
    assert nodes["values"].sum() == count


def test_a_falling_table_and_a_torque_that_is_never_negative():
    nodes = np.zeros(1, [("values", np.int64, (8,)), ("powered", np.int64)]).view(np.recarray)
    function = getattr(brake_torque, "py_func", brake_torque)
    axis = coupled(brake_output=BrakeOutput.OBJECT, brake_channel=2, brake_scale_Nm=0.01)
    for raw, powered, torque in ((100, 1, 1.0), (-100, 1, 0.0), (100, 0, 0.0)):
        nodes[0]["values"][2], nodes[0]["powered"] = raw, powered
        assert function(axis[0], nodes[0]) == pytest.approx(torque)
    axis[0]["brake_points"] = 3
    axis[0]["brake_table_raw"][:3], axis[0]["brake_table_Nm"][:3] = (-1000, -200, 0), (6.0, 2.0, 0.0)
    nodes[0]["powered"] = 1
    for raw, torque in ((0, 0.0), (50, 0.0), (-100, 1.0), (-600, 4.0), (-5000, 6.0)):
        nodes[0]["values"][2] = raw
        assert function(axis[0], nodes[0]) == pytest.approx(torque)


# what is believed wrongly


@pytest.mark.parametrize(("object_", "mode"), [("6071", None), ("2030", -3)])
def test_a_motor_that_is_weaker_than_believed(object_, mode):
    motor = with_variable(edited(another(MOTOR), "6072", DefaultValue=1000), "2030", I16, 0)
    text = role("torque_setpoint", object=object_, scale_Nm=0.0001) if mode else ""
    options = (FOREIGN_MOTOR, *(() if mode is None else (f"motor.mode={mode}",)))
    torques = []
    for rated in ("", "plant.motor_rated_torque_Nm=0.09"):  # half of what is believed
        world = world_of(motor, BRAKE, *options, *((rated,) if rated else ()), text=text)
        enable(world, 1, mode or 10)
        write(world, 1, int(object_, 16), 0, -90, 2)
        torques.append(float(world.plant[0]["motor_pm"]) * float(world.plant[0]["motor_Nm_pm"]))
    assert torques[1] == pytest.approx(torques[0] / 2)
    assert torques[0] < -0.05


def test_a_brake_that_is_stronger_than_believed_has_the_current_that_is_expected():
    look_at = {}
    for gain in (1.0, 1.7):
        world = world_of(MOTOR, BRAKE, f"plant.brake_gain={gain}", "plant.brake_off_state_Nm=0")
        world.plant[0]["inertia"], world.plant[0]["v"] = 1e4, 1.0  # it slides on and on
        write(world, 2, 0x7300, 1, 3000, 2)
        world.wait_ns(80 * MS)
        look(world)
        look_at[gain] = float(world.plant[0]["f_brake"]), int(world.brake[0x7130, 2])
    assert look_at[1.0][0] == pytest.approx(-3.0, rel=0.02)
    assert look_at[1.7][0] == pytest.approx(1.7 * look_at[1.0][0])
    assert look_at[1.7][1] == look_at[1.0][1] == pytest.approx(600, abs=1)
