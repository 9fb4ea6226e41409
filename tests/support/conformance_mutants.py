"""Nodes that do one thing wrong: what they send or receive is changed on its way.

Each names the case that must catch it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from conformance_bench import VirtualLink
from coulombus.wire.bus_link import RTR, BusFrame

ABORT = 0x80
MS = 1_000_000


@dataclass(frozen=True)
class Mutant:
    name: str
    case: str
    sends: Callable | None = None
    takes: Callable | None = None
    device: str = "motor"


class MutantLink(VirtualLink):
    """A link that lets the mutant's functions change frames; `sends` of the node, `takes` on their
    way to it.
    """

    mutant: Mutant

    def prepare(self):
        self.memory = {}
        self.request = bytes(8)

    def send(self, can_id, data=b"", length=None):
        if can_id == 0x601 and len(data) == 8:
            self.request = data
        size = len(data) if length is None else length
        found = (can_id, data, size)
        if self.mutant.takes is not None:
            found = self.mutant.takes(self, can_id, data, size)
        if isinstance(found, bytes):  # an SDO response of the mutant's own
            self.t += 100_000
            self.sent.append(BusFrame(self.t, 0x581, found, 8))
        elif found is not None:
            super().send(found[0], found[1], found[2])
        else:
            self.until(self.t + 100_000)

    def tamper(self, frame):
        if self.mutant.sends is None:
            return [frame]
        found = self.mutant.sends(self, frame)
        return found if isinstance(found, list) else [] if found is None else [found]


MUTANTS: list[Mutant] = []


def sends(case, device="motor"):
    def register(function):
        MUTANTS.append(Mutant(f"{function.__name__}-{case}", case, sends=function, device=device))
        return function

    return register


def takes(case, device="motor"):
    def register(function):
        MUTANTS.append(Mutant(f"{function.__name__}-{case}", case, takes=function, device=device))
        return function

    return register


def with_data(frame, data):
    return replace(frame, data=bytes(data), length=len(data))


def is_abort(frame):
    return frame.can_id == 0x581 and frame.data[0] == ABORT


def aborting(code):
    def change(link, frame):
        return with_data(frame, frame.data[:4] + code.to_bytes(4, "little")) if is_abort(frame) else frame

    return change


def place(data):
    return int.from_bytes(data[1:3], "little"), data[3]


def written(data):
    """Object of an initiating download, else None."""
    return place(data) if data[0] >> 5 == 1 else None


def ok(data):
    return bytes((0x60, data[1], data[2], data[3], 0, 0, 0, 0))


# wrong abort codes, one for each case that has a list of its own

for number, wrong in (
    ("2.3", 0x06020000),
    ("2.4", 0x06090011),
    ("2.5", 0x06020000),
    ("2.6", 0x06090011),
    ("2.7", 0x06010000),
    ("2.8", 0x06090031),
    ("2.9", 0x06070012),
    ("2.10", 0x06090032),
    ("2.11", 0x06090031),
    ("2.17", 0x05040001),
    ("2.26", 0x05030000),
    ("2.27", 0x05030000),
    ("2.28", 0x06090011),
    ("3.1", 0x06090011),
    ("3.2", 0x06090011),
    ("3.25", 0x06090030),
    ("3.26", 0x08000022),
    ("4.3", 0x06010001),
    ("4.4", 0x06010002),
    ("6.9", 0x06090030),
    ("7.104", 0x06090030),
    ("8.2", 0x06090030),
    ("8.4", 0x06090030),
):
    MUTANTS.append(Mutant(f"abort_code_{wrong:08X}-{number}", number, sends=aborting(wrong)))


# SDO


@sends("2.1")
def device_type_of_two_bytes(link, frame):
    return with_data(frame, b"\x4b" + frame.data[1:]) if frame.data[:4] == b"\x43\x00\x10\x00" else frame


@sends("2.12")
def server_identifier_of_another_node(link, frame):
    return with_data(frame, frame.data[:4] + b"\x02\x06\0\0") if frame.data[:4] == b"\x43\x00\x12\x01" else frame


@sends("2.16")
@sends("2.18")
def frozen_toggle_bit(link, frame):
    if frame.can_id == 0x581 and link.request[0] >> 5 == 3:
        return with_data(frame, bytes((frame.data[0] & ~0x10,)) + frame.data[1:])
    return frame


@sends("2.16")
def segment_length_wrong(link, frame):
    if frame.can_id == 0x581 and link.request[0] >> 5 == 3 and frame.data[0] & 1:
        return with_data(frame, bytes((frame.data[0] & ~0x0E,)) + frame.data[1:])
    return frame


@sends("2.15")
@sends("S.1")
def download_toggle_frozen(link, frame):
    if frame.can_id == 0x581 and link.request[0] >> 5 == 0 and frame.data[0] & 0xEF == 0x20:
        return with_data(frame, bytes((frame.data[0] ^ 0x10,)) + frame.data[1:])
    return frame


@takes("2.17")
@takes("S.2")
def toggle_not_checked(link, can_id, data, length):
    if can_id == 0x601 and data[0] >> 5 in (0, 3):
        wanted = link.memory.get("toggle", 0)
        link.memory["toggle"] = wanted ^ 0x10
        return can_id, bytes((data[0] & ~0x10 | wanted,)) + data[1:], length
    link.memory["toggle"] = 0
    return can_id, data, length


@sends("2.23")
def crc_of_block_upload_wrong(link, frame):
    if frame.can_id == 0x581 and frame.data[0] & 0xE3 == 0xC1 and link.request[0] & 0xE3 == 0xA2:
        return with_data(frame, bytes((frame.data[0], frame.data[1] ^ 1)) + frame.data[2:])
    return frame


@takes("B.7")
def crc_of_block_download_not_checked(link, can_id, data, length):
    if can_id == 0x601 and data[0] & 0xE3 == 0xC1:
        crc = int.from_bytes(data[1:3], "little") ^ 0x5555
        return can_id, data[:1] + crc.to_bytes(2, "little") + data[3:], length
    return can_id, data, length


@takes("B.1")
def block_is_never_repeated(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0xA2:
        return can_id, bytes((data[0], link.memory.get("sequence", data[1]), data[2])) + data[3:], length
    return can_id, data, length


def _remember_sequence(link, frame):
    if frame.can_id == 0x581 and 1 <= frame.data[0] & 0x7F <= 2:
        link.memory["sequence"] = frame.data[0] & 0x7F
    return frame


MUTANTS[-1] = replace(MUTANTS[-1], sends=_remember_sequence)


@takes("2.10")
@takes("4.6")
@takes("6.5")
def limits_not_enforced(link, can_id, data, length):
    """A value above 1019h's limit is answered with success."""
    if can_id == 0x601 and written(data) == (0x1019, 0) and data[4] > 240:
        return ok(data)
    return can_id, data, length


@takes("2.3")
@takes("4.3")
def read_only_taken(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1000, 0) else (can_id, data, length)


@sends("4.2")
def default_is_not_the_edss(link, frame):
    return with_data(frame, frame.data[:4] + b"\1\0\0\0") if frame.data[:4] == b"\x4b\x17\x10\x00" else frame


@takes("4.9")
def own_value_refused(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1015, 0):
        return bytes((ABORT, *data[1:4])) + (0x06010002).to_bytes(4, "little")
    return can_id, data, length


@sends("4.1")
@sends("4.7")
def object_is_missing(link, frame):
    if frame.can_id == 0x581 and frame.data[0] >> 5 == 2 and place(frame.data) == (0x1015, 0):
        return with_data(frame, b"\x80" + frame.data[1:4] + (0x06020000).to_bytes(4, "little"))
    return frame


# PDO


@takes("3.3")
def rtr_ignored(link, can_id, data, length):
    return None if can_id & RTR and can_id & 0x7FF in range(0x181, 0x500) else (can_id, data, length)


@sends("3.5")
def event_timer_twice_as_slow(link, frame):
    if frame.can_id == 0x181:
        link.memory["n"] = link.memory.get("n", 0) + 1
        return frame if link.memory["n"] % 2 else None
    return frame


@sends("3.6")
@sends("6.3")
def a_synchronous_tpdo_is_lost(link, frame):
    if frame.can_id == 0x181:
        link.memory["n"] = link.memory.get("n", 0) + 1
        return frame if link.memory["n"] % 4 else None
    return frame


@sends("3.6")
def a_tpdo_too_many(link, frame):
    return [frame, frame] if frame.can_id == 0x181 and frame.length == 8 else frame


@sends("3.4")
@sends("3.7")
def events_are_not_told(link, frame):
    return (
        None
        if frame.can_id == 0x181 and frame.length == 2 and link.memory.setdefault("first", frame) != frame
        else frame
    )


@takes("3.8")
def start_value_ignored(link, can_id, data, length):
    if can_id == 0x601 and (written(data) or (0, 0)) == (0x1800, 6):
        return ok(data)
    return can_id, data, length


@takes("3.12")
@takes("3.9")
@takes("9.4")
@takes("10.4")
def stop_does_not_stop(link, can_id, data, length):
    return None if can_id == 0 and data[0] == 2 else (can_id, data, length)


@takes("3.18")
@takes("10.2")
def pre_operational_is_ignored(link, can_id, data, length):
    return None if can_id == 0 and data[0] == 128 else (can_id, data, length)


@takes("3.24")
def mapping_taken_while_valid(link, can_id, data, length):
    """Writes to the map succeed, and reads tell what was written."""
    if can_id != 0x601 or place(data)[0] != 0x1A00:
        return can_id, data, length
    if data[0] >> 5 == 1:
        link.memory[place(data)] = data[4:]
        return ok(data)
    if data[0] == 0x40 and place(data) in link.memory:
        size = 1 if data[3] == 0 else 4
        return bytes((0x43 | (4 - size) << 2, *data[1:4])) + link.memory[place(data)][:size].ljust(4, b"\0")
    return can_id, data, length


for number in ("3.23", "3.25", "3.26", "3.31", "3.32"):
    MUTANTS.append(Mutant(f"any_map_is_taken-{number}", number, takes=mapping_taken_while_valid))


@takes("3.27")
@takes("3.33")
def no_map_is_taken(link, can_id, data, length):
    if can_id == 0x601 and (written(data) or (0, 0))[0] in (0x1600, 0x1A00) and data[3]:
        return bytes((ABORT, *data[1:4])) + (0x06040041).to_bytes(4, "little")
    return can_id, data, length


@sends("3.21")
def default_map_names_nothing(link, frame):
    return with_data(frame, frame.data[:4] + b"\x20\0\x99\x60") if frame.data[:4] == b"\x43\x00\x1a\x02" else frame


@takes("T.1")
def inhibit_time_ignored(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1800, 3) else (can_id, data, length)


@takes("R.1")
def synchronous_rpdo_acts_at_once(link, can_id, data, length):
    if can_id == 0x501:
        link.deliver(can_id, data, length)
        link.deliver(0x80, b"", 0)
        return None
    return can_id, data, length


# EMCY


@sends("5.4")
def emcy_is_not_sent(link, frame):
    return None if frame.can_id == 0x81 else frame


@sends("5.5")
def error_register_stays_zero(link, frame):
    return with_data(frame, frame.data[:4] + bytes(4)) if frame.data[:4] == b"\x4f\x01\x10\x00" else frame


@sends("5.6")
def no_entry_in_1003(link, frame):
    return with_data(frame, frame.data[:4] + bytes(4)) if frame.data[:4] == b"\x4f\x03\x10\x00" else frame


@sends("5.1")
def emcy_identifier_wrong(link, frame):
    return with_data(frame, frame.data[:4] + b"\x80\0\0\0") if frame.data[:4] == b"\x43\x14\x10\x00" else frame


@sends("E.1")
def error_reset_is_not_told(link, frame):
    return None if frame.can_id == 0x81 and frame.data[:2] == b"\0\0" else frame


@takes("E.3")
def emcy_inhibit_time_ignored(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1015, 0) else (can_id, data, length)


MUTANTS[-1] = replace(MUTANTS[-1], device="mr_brake")


# SYNC


@sends("6.7")
@sends("6.10")
def counter_overflows_one_late(link, frame):
    if frame.can_id == 0x80 and frame.length:
        link.memory["n"] = link.memory.get("n", 0) % 6 + 1
        return with_data(frame, bytes((link.memory["n"],)))
    return frame


@sends("6.6")
def counter_without_1019(link, frame):
    return with_data(frame, b"\1") if frame.can_id == 0x80 and not frame.length else frame


@sends("6.2")
def every_other_sync(link, frame):
    if frame.can_id == 0x80:
        link.memory["n"] = link.memory.get("n", 0) + 1
        return frame if link.memory["n"] % 2 else None
    return frame


@takes("6.9")
def counter_taken_while_running(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1019, 0) else (can_id, data, length)


@takes("6.4")
def tester_s_sync_ignored(link, can_id, data, length):
    return None if can_id == 0x80 else (can_id, data, length)


# error control


@sends("7.3")
@sends("7.203")
def guarding_toggle_frozen(link, frame):
    return with_data(frame, bytes((frame.data[0] & 0x7F,))) if frame.can_id == 0x701 and frame.length else frame


@takes("7.2")
def guarding_ignored(link, can_id, data, length):
    return None if can_id == 0x701 | RTR else (can_id, data, length)


@takes("7.4")
def answers_to_every_guarding(link, can_id, data, length):
    return 0x701 | RTR if can_id & RTR and can_id & 0x780 == 0x700 else can_id, data, length


@takes("7.6")
def life_guarding_without_event(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x100D, 0) else (can_id, data, length)


@sends("7.102")
@sends("7.204")
def heartbeat_at_twice_the_period(link, frame):
    if frame.can_id == 0x701 and frame.data != b"\0":
        link.memory["n"] = link.memory.get("n", 0) + 1
        return frame if link.memory["n"] % 2 else None
    return frame


@sends("7.102")
def heartbeat_of_two_bytes(link, frame):
    return with_data(frame, frame.data + b"\0") if frame.can_id == 0x701 and frame.data != b"\0" else frame


@takes("7.103")
@takes("7.202")
def heartbeat_cannot_be_switched_off(link, can_id, data, length):
    off = can_id == 0x601 and written(data) == (0x1017, 0) and data[4:6] == b"\0\0"
    return ok(data) if off else (can_id, data, length)


@takes("7.106")
def consumer_watches_nothing(link, can_id, data, length):
    return None if can_id == 0x77E else (can_id, data, length)


@takes("7.105")
def consumer_is_too_fast(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1016, 1) and data[4]:
        return can_id, data[:4] + b"\x0a\0" + data[6:], length
    return can_id, data, length


@takes("7.104")
def one_node_in_two_entries(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1016, 2) else (can_id, data, length)


@sends("7.205")
@sends("7.207")
def guarding_beside_the_heartbeat(link, frame):
    return frame


MUTANTS[-2:] = [
    replace(
        one,
        takes=lambda link, can_id, data, length: (
            link.sent.append(BusFrame(link.t, 0x701, b"\x7f", 1)) if can_id == 0x701 | RTR else (can_id, data, length)
        ),
    )
    for one in MUTANTS[-2:]
]


# store, restore, states


@takes("8.5")
@takes("6.8")
@takes("8.9")
def store_does_nothing(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and (written(data) or (0, 0))[0] == 0x1010 else (can_id, data, length)


@takes("8.7")
@takes("8.8")
def restore_does_nothing(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and (written(data) or (0, 0))[0] == 0x1011 else (can_id, data, length)


@takes("8.2")
@takes("8.4")
def any_signature_is_taken(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and (written(data) or (0, 0))[0] in (0x1010, 0x1011) else (can_id, data, length)


@takes("8.10")
def restricted_identifier_taken(link, can_id, data, length):
    taken = can_id == 0x601 and written(data) == (0x1800, 1) and data[4:8] == b"\xff\x06\0\0"
    return ok(data) if taken else (can_id, data, length)


@sends("9.1")
@sends("9.2")
@sends("10.1")
def boot_up_is_missing(link, frame):
    return None if frame.can_id == 0x701 and frame.data == b"\0" else frame


@sends("9.1")
def boot_up_tells_a_state(link, frame):
    return with_data(frame, b"\x7f") if frame.can_id == 0x701 and frame.data == b"\0" else frame


@takes("9.1")
def reset_is_half_done(link, can_id, data, length):
    """Heartbeat time survives a reset: reads of 1017h tell what was written last."""
    if can_id == 0x601 and written(data) == (0x1017, 0):
        link.memory["time"] = data[4:6]
    if can_id == 0x601 and data[:4] == b"\x40\x17\x10\x00" and "time" in link.memory:
        return b"\x4b\x17\x10\x00" + link.memory["time"] + b"\0\0"
    return can_id, data, length


@takes("10.1")
def reset_communication_ignored(link, can_id, data, length):
    return None if can_id == 0 and data[0] == 130 else (can_id, data, length)


@takes("10.3")
@takes("9.3")
def start_ignored(link, can_id, data, length):
    return None if can_id == 0 and data[0] == 1 else (can_id, data, length)


@takes("N.1")
def every_node_id_is_its_own(link, can_id, data, length):
    return (can_id, data[:1] + b"\x01", length) if can_id == 0 and length == 2 else (can_id, data, length)


@takes("N.2")
def a_short_command_acts(link, can_id, data, length):
    return (0, data + b"\x01", 2) if can_id == 0 and length == 1 else (can_id, data, length)


@sends("9.4")
def heartbeat_tells_pre_operational_always(link, frame):
    return with_data(frame, b"\x7f") if frame.can_id == 0x701 and frame.data != b"\0" else frame


# LSS, drive


@sends("L.1")
def lss_tells_another_node_id(link, frame):
    if frame.can_id == 0x7E4 and frame.data[0] == 0x5E:
        return with_data(frame, b"\x5e\x07" + bytes(6))
    return frame


@takes("L.2")
def lss_serial_number_ignored(link, can_id, data, length):
    if can_id == 0x7E5 and data[0] == 0x43:
        return can_id, b"\x43\x01\0\0\0\0\0\0", length
    return can_id, data, length


@sends("L.4")
@sends("L.5")
def lss_takes_anything(link, frame):
    if frame.can_id == 0x7E4 and frame.data[0] in (0x11, 0x13):
        return with_data(frame, frame.data[:1] + bytes(7))
    return frame


@takes("P.7")
def fault_reset_by_level(link, can_id, data, length):
    """A controlword with bit 7 is preceded by one without."""
    if can_id == 0x601 and written(data) == (0x6040, 0) and data[4] == 0x80:
        link.deliver(0x601, data[:4] + bytes(4), 8)
        link.sent.clear()
    return can_id, data, length


@takes("P.6")
def enable_operation_skips_states(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x6040, 0) and data[4] == 0x0F:
        for word in (6, 7):
            link.deliver(0x601, data[:4] + bytes((word, 0, 0, 0)), 8)
        link.sent.clear()
    return can_id, data, length


@sends("P.8")
def mode_display_is_stuck(link, frame):
    return with_data(frame, frame.data[:4] + b"\x0a\0\0\0") if frame.data[:4] == b"\x4f\x61\x60\x00" else frame


@takes("P.8")
def any_mode_is_taken(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x6060, 0):
        link.memory["mode"] = data[4:5]
        return ok(data)
    if can_id == 0x601 and data[:4] == b"\x40\x61\x60\x00" and "mode" in link.memory:
        return b"\x4f\x61\x60\x00" + link.memory["mode"] + bytes(3)
    return can_id, data, length


# requests out of turn


@takes("B.11")
def threshold_of_255(link, can_id, data, length):
    if can_id == 0x601 and data[0] & 0xE3 == 0xA0 and data[5]:
        return can_id, data[:5] + b"\xff" + data[6:], length
    return can_id, data, length


@takes("B.12")
def end_of_upload_is_answered(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0xA1:
        link.sent.append(BusFrame(link.t, 0x581, b"\xa1" + bytes(7), 8))
    return can_id, data, length


@takes("B.13")
def acknowledge_beyond_the_block(link, can_id, data, length):
    if can_id == 0x601 and data[:3] == b"\xa2\x02\x01":
        return can_id, b"\xa2\x01" + data[2:], length
    return can_id, data, length


@takes("S.6")
def said_length_ignored(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0x21:
        return can_id, b"\x20" + data[1:4] + bytes(4), length
    return can_id, data, length


@takes("S.7")
def length_must_be_said(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0x22:
        return bytes((ABORT, *data[1:4])) + (0x06070010).to_bytes(4, "little")
    return can_id, data, length


@sends("S.8")
@sends("S.9")
@sends("S.10")
def segment_without_a_transfer(link, frame):
    if is_abort(frame) and link.request[0] >> 5 in (0, 3):
        return with_data(frame, bytes((0x20 if link.request[0] >> 5 == 0 else 0x0F,)) + bytes(7))
    return frame


@sends("S.11")
def response_echoes_its_request(link, frame):
    if frame.can_id == 0x581 and frame.data[0] == 0x60:
        return with_data(frame, frame.data[:4] + link.request[4:])
    return frame


@sends("S.12")
def second_server_answers_as_the_first(link, frame):
    return replace(frame, can_id=0x581) if frame.can_id == 0x6D9 else frame


# PDOs, tried harder; 501h is the RPDO that carries one harmless object


@takes("R.4")
def long_rpdo_dropped(link, can_id, data, length):
    return None if can_id == 0x501 and length == 5 else (can_id, data, length)


@takes("R.5")
def short_rpdo_used(link, can_id, data, length):
    return (can_id, data + b"\0", 4) if can_id == 0x501 and length == 3 else (can_id, data, length)


@takes("R.6")
def first_rpdo_wins(link, can_id, data, length):
    return None if can_id == 0x501 and data[0] == 22 else (can_id, data, length)


@takes("R.7")
def dummy_takes_no_room(link, can_id, data, length):
    return (can_id, data[1:] + b"\0", length) if can_id == 0x501 else (can_id, data, length)


def emcy_code(before, after):
    def change(link, frame):
        found = frame.can_id == 0x81 and frame.data[:2] == before.to_bytes(2, "little")
        return with_data(frame, after.to_bytes(2, "little") + frame.data[2:]) if found else frame

    return change


for number, before, after in (("R.4", 0x8220, 0x8210), ("R.8", 0x8250, 0x8240), ("Y.1", 0x8240, 0x8220)):
    MUTANTS.append(Mutant(f"emcy_{after:04X}_for_{before:04X}-{number}", number, sends=emcy_code(before, after)))


def swallowing(*places):
    """Writes to these objects are answered with success, and do nothing."""

    def change(link, can_id, data, length):
        return ok(data) if can_id == 0x601 and written(data) in places else (can_id, data, length)

    return change


for number, found in (
    ("R.9", (0x1007, 0)),
    ("E.4", (0x1014, 0)),
    ("E.5", (0x1014, 0)),
    ("Y.2", (0x1005, 0)),
    ("Y.4", (0x1014, 0)),
    ("Y.4", (0x1005, 0)),
    ("H.5", (0x1029, 1)),
    ("T.7", (0x1800, 3)),
    ("T.7", (0x1800, 6)),
    ("P.10", (0x605A, 0)),
    ("R.10", (0x1400, 2)),
    ("Y.5", (0x1014, 0)),
):
    MUTANTS.append(Mutant(f"write_to_{found[0]:04X}_{found[1]}_ignored-{number}", number, takes=swallowing(found)))


@takes("T.3")
def bit_30_ignored(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1800, 1):
        return can_id, data[:7] + bytes((data[7] & ~0x40,)), length
    return can_id, data, length


def another_type(before, after):
    def change(link, can_id, data, length):
        found = can_id == 0x601 and written(data) == (0x1800, 2) and data[4] == before
        return (can_id, data[:4] + bytes((after,)) + data[5:], length) if found else (can_id, data, length)

    return change


for number, before, after in (
    ("T.4", 252, 253),
    ("T.5", 253, 252),
    ("T.5", 253, 1),
    ("T.6", 254, 253),
    ("T.6", 255, 1),
):
    name = f"type_{before}_as_{after}-{number}"
    MUTANTS.append(Mutant(name, number, takes=another_type(before, after)))


@takes("T.8")
def twelve_bits_taken(link, can_id, data, length):
    return ok(data) if can_id == 0x601 and written(data) == (0x1800, 1) and data[5] == 0x18 else (can_id, data, length)


@takes("T.9")
def empty_tpdo_is_sent(link, can_id, data, length):
    if can_id == 0x80:
        link.sent.append(BusFrame(link.t, 0x181, b"", 0))
    return can_id, data, length


MUTANTS.append(Mutant("any_map_is_taken-M.1", "M.1", takes=mapping_taken_while_valid))


# services, tried harder

for number in ("E.6", "Y.3"):
    MUTANTS.append(Mutant(f"stop_does_not_stop-{number}", number, takes=stop_does_not_stop))


def told(place, value):
    """Reads of an object tell this value."""
    index, subindex = place
    asked = bytes((index & 0xFF, index >> 8, subindex))

    def change(link, frame):
        found = frame.can_id == 0x581 and frame.data[0] & 0xE3 == 0x43 and frame.data[1:4] == asked
        return with_data(frame, frame.data[:4] + value.to_bytes(4, "little")) if found else frame

    return change


for number, place_, value in (
    ("E.7", (0x1003, 1), 0x8130),
    ("E.8", (0x1001, 0), 0x11),
    ("K.1", (0x1020, 1), 14_000),
    ("P.7", (0x603F, 0), 0),
):
    MUTANTS.append(Mutant(f"{place_[0]:04X}_is_stuck-{number}", number, sends=told(place_, value)))


@sends("E.9")
def only_one_emcy(link, frame):
    return frame if frame.can_id != 0x81 or link.memory.setdefault("first", frame) == frame else None


@takes("H.1")
def second_entry_watches_nothing(link, can_id, data, length):
    return None if can_id == 0x77C else (can_id, data, length)


@takes("H.2")
def watch_begins_with_the_write(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1016, 1) and data[4]:
        link.deliver(can_id, data, length)
        link.deliver(0x77E, b"\x05", 1)
        return None
    return can_id, data, length


@takes("H.3")
def unused_entry_counts(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1016, 2):
        return bytes((ABORT, *data[1:4])) + (0x06040043).to_bytes(4, "little")
    return can_id, data, length


@takes("H.4")
def consumer_waits_twice_as_long(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1016, 1) and data[4] == 100:
        return can_id, data[:4] + b"\xc8" + data[5:], length
    return can_id, data, length


@takes("N.3")
def reserved_command_starts(link, can_id, data, length):
    return (can_id, b"\x01" + data[1:], length) if can_id == 0 and data[0] == 5 else (can_id, data, length)


@takes("K.2")
def every_group_is_stored(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1010, 2):
        link.deliver(can_id, data[:3] + b"\x01" + data[4:], length)
        link.sent.clear()
        return ok(data)
    return can_id, data, length


@takes("L.2")
def lss_revision_ignored(link, can_id, data, length):
    return (can_id, b"\x42\0\0\1\0\0\0\0", length) if can_id == 0x7E5 and data[0] == 0x42 else (can_id, data, length)


@takes("L.3")
def lss_serial_range_has_no_end(link, can_id, data, length):
    if can_id == 0x7E5 and data[0] == 0x4B:
        return can_id, b"\x4b\xff\xff\xff\xff\0\0\0", length
    return can_id, data, length


@takes("L.5")
def lss_table_ignored(link, can_id, data, length):
    return (can_id, b"\x13\0" + data[2:], length) if can_id == 0x7E5 and data[0] == 0x13 else (can_id, data, length)


@takes("L.7")
def lss_waiting_answers(link, can_id, data, length):
    if can_id == 0x7E5 and data[0] == 0x5E:
        link.sent.append(BusFrame(link.t, 0x7E4, b"\x5e\x01" + bytes(6), 8))
    return can_id, data, length


@takes("L.8")
def lss_node_id_acts_at_once(link, can_id, data, length):
    if can_id == 0x7E5 and data[0] == 0x11:
        link.memory["id"] = data[1]
    return None if can_id == 0x601 and link.memory.get("id", 1) != 1 else (can_id, data, length)


@takes("L.9")
def lss_255_is_acknowledged_and_forgotten(link, can_id, data, length):
    if can_id == 0x7E5 and data[:2] == b"\x11\xff":
        link.sent.append(BusFrame(link.t, 0x7E4, b"\x11" + bytes(7), 8))
        return None
    return can_id, data, length


@takes("B.14")
def block_segment_0_is_taken_as_1(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0 and link.memory.get("block"):
        data = b"\x01" + data[1:]
    if can_id == 0x601:
        link.memory["block"] = data[0] & 0xE1 == 0xC0
    return can_id, data, length


@sends("P.5")
def quick_stop_stays(link, frame):
    stays = frame.data[:4] == b"\x4b\x41\x60\x00" and frame.data[4] & 0x6F == 0x40 and link.memory.get("quick")
    return with_data(frame, frame.data[:4] + b"\x17\x02\0\0") if stays else frame


def _remember_quick_stop(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x6040, 0):
        link.memory["quick"] = data[4] & 0x0F == 0x02
    return can_id, data, length


MUTANTS[-1] = replace(MUTANTS[-1], takes=_remember_quick_stop)


@takes("N.4")
def reset_communication_resets_all(link, can_id, data, length):
    return (can_id, b"\x81" + data[1:], length) if can_id == 0 and data[0] == 130 else (can_id, data, length)


@takes("M.1")
def dummy_goes_into_a_tpdo(link, can_id, data, length):
    if can_id == 0x601 and written(data) == (0x1A00, 1) and data[6:8] == b"\x05\0":
        return can_id, data[:4] + b"\x08\0\x61\x60", length
    return can_id, data, length


MUTANTS.append(Mutant("emcy_8100_for_8130-H.4", "H.4", sends=emcy_code(0x8130, 0x8100)))
MUTANTS.append(Mutant("1003_lists_the_reset-E.1", "E.1", sends=told((0x1003, 1), 0)))


@sends("Y.6")
def counter_goes_on_over_a_reset(link, frame):
    if frame.can_id == 0x80 and frame.length:
        link.memory["n"] = link.memory.get("n", 0) % 5 + 1
        return with_data(frame, bytes((link.memory["n"],)))
    return frame
