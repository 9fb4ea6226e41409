"""Nodes that do something otherwise than ours, and as CiA 301, 305, 306 and 402 allow it: no case
may fail them.

What they send or receive is changed on its way, as of the mutants. Most of it is what Lely's stack,
CANopenNode or gocanopen do.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from conformance_bench import VirtualLink, description
from conformance_mutants import MutantLink, is_abort, place, with_data, written
from coulombus.eds.cia301 import Abort
from coulombus.eds.reader import parse_eds
from coulombus.wire.bus_link import BusFrame

MS = 1_000_000
PASS, EITHER = ("pass",), ("pass", "not_applicable")
NOT = ("not_applicable",)
TEXT = (0x2004, 0)
TEXTS = ("B.6", "B.7", "B.8", "B.9", "B.14", "S.1", "S.2", "S.6", "S.7", "S.8", "S.10", "S.11", "N.4", "K.2")
BLOCKS = ("2.19", "2.20", "2.22", "2.26", "2.27", *(f"B.{k}" for k in range(1, 15)))
UPLOADS = ("2.16", "2.17", "2.18", "2.22", "4.1", "4.2", "4.3", "B.1", "B.11", "S.3", "S.8")
REMAPPED = ("3.22", "3.23", "3.24", "3.25", "3.26", "3.27", "3.28", "3.29", "3.30", "3.31", "3.32", "3.33", "M.1")


@dataclass(frozen=True)
class Foreign:
    name: str
    cases: tuple[str, ...]
    expected: tuple[str, ...] = PASS
    sends: Callable | None = None
    takes: Callable | None = None
    device: str = "motor"
    eds: Callable[[str], str] | None = None
    """What of our EDS is otherwise."""

    def description(self):
        if self.eds is None:
            return description(self.device)
        return parse_eds(self.eds(description(self.device).text).encode(), f"{self.device}.eds")


class ForeignLink(MutantLink):
    """A link that lets the functions of `mutant`, a `Foreign`, change frames."""

    def send(self, can_id, data=b"", length=None):
        if can_id == 0x601 and len(data) < 8:
            VirtualLink.send(self, can_id, data, length)
        else:
            super().send(can_id, data, length)

    def ask(self, data: bytes) -> bytes:
        """Return the node's own response to an SDO request; the tester does not see it."""
        before = len(self.sent)
        VirtualLink.send(self, 0x601, data)
        answers = [frame for frame in list(self.sent)[before:] if frame.can_id == 0x581]
        for frame in answers:
            self.sent.remove(frame)
        return answers[-1].data if answers else b""


FOREIGN: list[Foreign] = []


def foreign(*cases, expected=PASS, device="motor", eds=None, way="takes"):
    def register(function):
        FOREIGN.append(Foreign(function.__name__, cases, expected, device=device, eds=eds, **{way: function}))
        return function

    return register


def abort(where, code):
    return b"\x80" + where[0].to_bytes(2, "little") + bytes((where[1],)) + int(code).to_bytes(4, "little")


def initiates(data):
    return data[0] >> 5 in (1, 2) or (data[0] >> 5 in (5, 6) and data[0] & 0x03 in (0, 2))


# SDO


def _new_initiation(names_the_old):
    def takes(link, can_id, data, length):
        if can_id != 0x601:
            return can_id, data, length
        old = link.memory.get("open")
        if old is not None and data[0] >> 5 in (1, 2, 5, 6):
            link.memory["open"] = None
            VirtualLink.send(link, 0x601, abort(old, Abort.GENERAL))
            return abort(old if names_the_old else place(data), Abort.COMMAND)
        answer = link.ask(data)
        if answer[:1] in (b"\x41", b"\x40"):
            link.memory["open"] = place(answer)
        elif data[0] >> 5 == 4 or answer[:1] == b"\x80" or (data[0] >> 5 == 3 and answer[0] & 1):
            link.memory["open"] = None
        return answer or None

    return takes


for name, names_the_old in (("old", True), ("new", False)):
    FOREIGN.append(
        Foreign(
            f"a_new_initiation_in_an_upload_is_aborted_in_the_name_of_the_{name}",
            ("2.16", "2.17", "2.18", "4.1", "4.2", "4.3", "S.3", "S.8", "S.9", "S.10"),
            takes=_new_initiation(names_the_old),
        )
    )


@foreign("S.2")
def a_wrong_toggle_bit_in_a_download_is_ignored(link, can_id, data, length):
    if can_id == 0x601 and data[0] >> 5 == 0:
        if data[0] & 0x10 != link.memory.get("toggle", 0):
            return None
        link.memory["toggle"] = link.memory.get("toggle", 0) ^ 0x10
    elif can_id == 0x601:
        link.memory["toggle"] = 0
    return can_id, data, length


@foreign("2.13", "S.3", "S.8", "S.9", "S.10", "B.12", "B.13", way="sends")
def what_is_not_for_the_server_is_ignored(link, frame):
    return None if is_abort(frame) and frame.data[4:] == b"\x01\0\x04\x05" else frame


@foreign(*TEXTS)
def a_text_has_room_for_twenty_bytes(link, can_id, data, length):
    if can_id == 0x601 and data[0] & 0xE1 in (0x21, 0xC0) and place(data) == TEXT and data[0] & 0x03:
        if data[0] >> 5 == 1 and data[0] & 2:
            return can_id, data, length
        if not (data[0] >> 5 == 6 and not data[0] & 2) and int.from_bytes(data[4:], "little") > 36:
            return abort(TEXT, Abort.TOO_LONG)
    return can_id, data, length


@foreign("S.1", "S.2", "S.6", "S.10", expected=NOT)
def a_text_has_room_for_eight_bytes(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0x21 and place(data) == TEXT and int.from_bytes(data[4:], "little") > 8:
        return abort(TEXT, Abort.LENGTH)
    return can_id, data, length


@foreign("B.6", "S.1", "N.4", "K.2", way="sends")
def texts_end_with_zeros(link, frame):
    """A string of a fixed length is filled up.

    Here each one that comes in one expedited or last segment.
    """
    last = frame.can_id == 0x581 and link.request[0] >> 5 == 3 and frame.data[0] & 0x01
    if last and frame.data[0] >> 1 & 7 and link.memory.get("text"):
        return with_data(frame, bytes((frame.data[0] & ~0x0E,)) + frame.data[1:])
    if frame.can_id == 0x581 and frame.data[0] == 0x41:
        link.memory["text"] = place(frame.data) == TEXT
        return with_data(frame, b"\x40" + frame.data[1:4] + bytes(4)) if link.memory["text"] else frame
    return frame


@foreign("S.2", "S.6", "B.7", "B.9")
def an_aborted_text_is_written_in_part(link, can_id, data, length):
    if can_id == 0x601 and data[0] >> 5 == 0 and link.memory.get("segments", 0) == 1:
        link.device[TEXT] = "a part"
    if can_id == 0x601:
        link.memory["segments"] = link.memory.get("segments", 0) + 1 if data[0] >> 5 == 0 else 0
    return can_id, data, length


@foreign(*UPLOADS, way="sends")
def uploads_do_not_tell_their_length(link, frame):
    if frame.can_id == 0x581 and frame.data[0] == 0x41:
        return with_data(frame, b"\x40" + frame.data[1:4] + bytes(4))
    return frame


@foreign("2.1", "2.2", "2.13", "4.1", "4.2", "4.3", "7.101", "3.1", "3.21", way="sends")
def expedited_uploads_do_not_tell_their_length(link, frame):
    if frame.can_id == 0x581 and frame.data[0] & 0xF3 == 0x43 and link.request[0] >> 5 == 2:
        return with_data(frame, b"\x42" + frame.data[1:])
    return frame


@foreign("2.1", "2.2", "4.1", "4.2", "7.101", way="sends")
def bytes_without_data_are_anything(link, frame):
    if frame.can_id == 0x581 and frame.data[0] & 0xF3 == 0x43 and link.request[0] >> 5 == 2:
        size = 4 - (frame.data[0] >> 2 & 3)
        return with_data(frame, frame.data[: 4 + size] + b"\xa5" * (4 - size))
    return frame


@foreign("2.1", "2.2", "2.13", "4.1", "4.2", "7.101", "9.1", "10.2")
def short_objects_come_by_segments(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0x40:
        answer = link.ask(data)
        link.memory["content"] = None
        if not answer:
            return None
        if answer[0] & 0xF3 != 0x43:
            return answer
        size = 4 - (answer[0] >> 2 & 3)
        link.memory["content"] = answer[4 : 4 + size]
        return b"\x41" + answer[1:4] + bytes((size, 0, 0, 0))
    if can_id == 0x601 and data[0] >> 5 == 3 and link.memory.get("content"):
        content, link.memory["content"] = link.memory["content"], None
        return bytes(((7 - len(content)) << 1 | 1,)) + content.ljust(7, b"\0")
    return can_id, data, length


@foreign("S.7")
def an_expedited_download_without_a_length_has_four_bytes(link, can_id, data, length):
    if can_id == 0x601 and data[0] == 0x22 and place(data) == (0x1017, 0):
        return abort(place(data), Abort.TOO_LONG)
    return can_id, data, length


def _no_blocks(code):
    def takes(link, can_id, data, length):
        return abort(place(data), code) if can_id == 0x601 and data[0] >> 5 in (5, 6) else (can_id, data, length)

    return takes


for code in (Abort.COMMAND, Abort.GENERAL):
    FOREIGN.append(Foreign(f"no_block_transfers_{code:08X}", BLOCKS, NOT, takes=_no_blocks(code)))


@foreign("2.20", "2.21", "B.6", "B.7", "B.8", "B.9", "B.10", "B.14", expected=NOT)
def no_block_downloads(link, can_id, data, length):
    return abort(place(data), Abort.COMMAND) if can_id == 0x601 and data[0] >> 5 == 6 else (can_id, data, length)


def _acknowledges_at_the_gap(link, can_id, data, length):
    if can_id != 0x601 or not link.memory.get("block"):
        if can_id == 0x601 and data[0] & 0xE1 == 0xC0:
            link.memory.update(block=True, received=0, early=False)
        return can_id, data, length
    number = data[0] & 0x7F
    if data[0] == 0x80 or (data[0] & 0xE3 == 0xC1 and not link.memory["received"]):
        link.memory["block"] = False
    elif number == link.memory["received"] + 1:
        link.memory["received"] = number
    elif not link.memory["early"]:
        link.memory["early"] = True
        link.sent.append(
            BusFrame(link.t + 100_000, 0x581, bytes((0xA2, link.memory["received"], 127, 0, 0, 0, 0, 0)), 8)
        )
    return can_id, data, length


def _only_once(link, frame):
    if frame.can_id == 0x581 and frame.data[0] == 0xA2 and link.memory.get("block"):
        early, link.memory["early"], link.memory["received"] = link.memory["early"], False, 0
        return None if early else frame
    return frame


FOREIGN.append(
    Foreign(
        "a_block_is_acknowledged_at_its_gap",
        ("B.8", "B.6", "2.20"),
        sends=_only_once,
        takes=_acknowledges_at_the_gap,
    )
)


@foreign("B.10")
def a_block_download_is_refused_with_its_first_segment(link, can_id, data, length):
    if can_id == 0x601 and data[0] & 0xE1 == 0xC0 and place(data) == (0x1000, 0):
        link.memory["refuses"] = True
        return b"\xa0" + data[1:4] + b"\x7f\0\0\0"
    if can_id == 0x601 and link.memory.pop("refuses", False):
        return abort((0x1000, 0), Abort.READ_ONLY)
    return can_id, data, length


@foreign("3.21", "4.1", "4.2", "4.7", "4.8", "P.1", way="sends")
def objects_cannot_be_read_in_this_state(link, frame):
    if frame.can_id == 0x581 and frame.data[1:4] in (b"\x77\x60\0", b"\x64\x60\0") and frame.data[0] & 0x40:
        return with_data(frame, abort(place(frame.data), Abort.DEVICE_STATE))
    return frame


@foreign("2.2", "4.9")
def a_parameter_cannot_be_written_in_this_state(link, can_id, data, length):
    if can_id == 0x601 and written(data) in ((0x1017, 0), (0x1016, 1), (0x1400, 2), (0x1800, 2), (0x6087, 0)):
        return abort(place(data), Abort.DEVICE_STATE)
    return can_id, data, length


def _other_codes(code):
    def sends(link, frame):
        later = is_abort(frame) and frame.data[4:] in (b"\x30\0\x09\x06", b"\x22\0\0\x08", b"\x31\0\x09\x06")
        return with_data(frame, frame.data[:4] + int(code).to_bytes(4, "little")) if later else frame

    return sends


for code in (Abort.PARAMETER_INCOMPATIBLE, Abort.LOCAL_CONTROL, Abort.CANNOT_STORE, Abort.READ_ONLY):
    FOREIGN.append(
        Foreign(
            f"refuses_with_{code:08X}",
            ("T.2", "T.7", "T.8", "R.10", "S.12", "Y.4", "Y.5", "E.2", "P.8", "P.10"),
            sends=_other_codes(code),
        )
    )


# NMT


def _deaf_after_nmt(duration_ns):
    def takes(link, can_id, data, length):
        if can_id == 0x000:
            link.memory["deaf"] = link.t + duration_ns
        elif link.t < link.memory.get("deaf", 0):
            return None
        return can_id, data, length

    return takes


FOREIGN.append(
    Foreign(
        "hears_nothing_for_15_ms_after_an_nmt_command",
        ("2.1", "3.3", "3.6", "3.22", "6.3", "7.2", "7.3", "9.1", "9.2", "9.3", "9.4", "10.1", "10.2", "R.1", "T.6"),
        takes=_deaf_after_nmt(15 * MS),
    )
)
FOREIGN.append(
    Foreign(
        "hears_no_sdo_for_half_a_second_after_an_nmt_command",
        ("2.1", "4.1", "8.5", "9.1", "10.1"),
        takes=lambda link, can_id, data, length: (
            _deaf_after_nmt(500 * MS)(link, can_id, data, length) if can_id in (0, 0x601) else (can_id, data, length)
        ),
    )
)


# PDO


def _granularity(bits):
    def takes(link, can_id, data, length):
        if can_id == 0x601 and length == 8 and written(data) is not None:
            index, subindex = written(data)
            if index in range(0x1600, 0x1800) or index in range(0x1A00, 0x1C00):
                if not bits:
                    return abort((index, subindex), Abort.READ_ONLY)
                if subindex and data[4] % bits:
                    return abort((index, subindex), Abort.NOT_MAPPABLE)
        return can_id, data, length

    return takes


for bits, expected in ((0, EITHER), (16, EITHER), (32, EITHER)):
    FOREIGN.append(
        Foreign(
            f"maps_in_steps_of_{bits}_bits",
            (*REMAPPED, "3.6", "3.7", "R.7", "R.1", "T.9"),
            expected,
            takes=_granularity(bits),
            eds=lambda text, bits=bits: text.replace("Granularity=1\n", f"Granularity={bits}\n"),
        )
    )


@foreign(
    "3.3",
    "3.9",
    "3.15",
    "T.3",
    expected=NOT,
    eds=lambda text: re.sub(r"(\[180.sub1\][^\[]*DefaultValue=\$NODEID\+)(\w+)", r"\g<1>0x40000000+\g<2>", text),
)
def answers_no_remote_frame_and_says_so(link, can_id, data, length):
    return None if can_id & 0x40000000 and can_id & 0x7FF in range(0x181, 0x500) else (can_id, data, length)


@foreign("3.4", "3.7", "3.10", "3.13", "T.6", expected=NOT, device="mr_brake", way="sends")
def a_change_of_the_error_register_is_no_event(link, frame):
    return None if frame.can_id in range(0x181, 0x500) and frame.length == 1 else frame


@foreign("R.6")
def an_rpdo_that_waits_outlives_stopped(link, can_id, data, length):
    if can_id == 0x000 and data[0] == 2 and link.memory.get("last"):
        link.memory["stopped"] = True
    elif can_id == 0x080 and link.memory.pop("stopped", False):
        VirtualLink.send(link, *link.memory["last"])
    elif can_id in (0x201, 0x301, 0x401, 0x501):
        link.memory["last"] = (can_id, data, length)
    return can_id, data, length


# EMCY


@foreign("5.1", "5.2", eds=lambda text: text.replace("=$NODEID+0x80\n", "=$NODEID+0x80000080\n"))
def no_emcy_is_sent_by_default(link, can_id, data, length):
    return can_id, data, length


@foreign("5.4", "5.5", "E.1", "E.3", "7.106", "H.1", expected=NOT, eds=FOREIGN[-1].eds)
def no_emcy_is_sent_by_default_(link, can_id, data, length):
    return can_id, data, length


@foreign("5.2", "5.3", "5.5", "E.8", way="sends")
def an_error_is_present_all_the_time(link, frame):
    if frame.can_id == 0x581 and frame.data[:4] == b"\x4f\x01\x10\0":
        return with_data(frame, frame.data[:4] + bytes((frame.data[4] | 0x81, 0, 0, 0)))
    if frame.can_id == 0x81:
        return with_data(frame, frame.data[:2] + bytes((frame.data[2] | 0x81,)) + frame.data[3:])
    return frame


@foreign("5.3", way="sends")
def the_history_outlives_a_reset_and_cannot_be_cleared(link, frame):
    if frame.can_id == 0x581 and link.request[:4] == b"\x40\x03\x10\0":
        return with_data(frame, b"\x4f\x03\x10\0\1\0\0\0")
    if frame.can_id == 0x581 and link.request[:4] == b"\x40\x03\x10\1":
        return with_data(frame, b"\x43\x03\x10\1\x30\x81\0\0")
    return frame


@foreign("E.1", expected=NOT, way="sends")
def an_error_stays_until_a_reset(link, frame):
    if frame.can_id == 0x81 and frame.data[:2] == b"\0\0":
        return None
    if frame.can_id == 0x581 and frame.data[:4] == b"\x4f\x01\x10\0":
        return with_data(frame, frame.data[:4] + b"\x11\0\0\0")
    return frame


# storing


def _keeps_1020(link, frame):
    key = frame.data[3] if frame.can_id == 0x581 and frame.data[1:3] == b"\x20\x10" else 0
    if key and frame.data[0] == 0x43 and link.memory.get("kept"):
        return with_data(frame, frame.data[:4] + link.memory["kept"])
    return frame


def _notes_1020(link, can_id, data, length):
    if can_id == 0x601 and written(data) in ((0x1020, 1), (0x1020, 2)):
        link.memory["kept"] = data[4:]
    if can_id == 0:
        link.memory["kept"] = None
    return can_id, data, length


FOREIGN.append(Foreign("1020_stays_until_the_boot_up_values_change", ("K.1",), sends=_keeps_1020, takes=_notes_1020))


# LSS


def _silent_services(*services):
    def takes(link, can_id, data, length):
        return None if can_id == 0x7E5 and data[0] in services else (can_id, data, length)

    return takes


FOREIGN.append(Foreign("no_lss_identify", ("L.3",), NOT, takes=_silent_services(*range(0x46, 0x4C))))
FOREIGN.append(Foreign("no_lss_bit_timing", ("L.5",), NOT, takes=_silent_services(0x13)))
FOREIGN.append(Foreign("no_lss_inquiries", ("L.1",), NOT, takes=_silent_services(0x5A, 0x5B, 0x5C, 0x5D, 0x5E)))
FOREIGN.append(Foreign("no_lss_inquiries_", ("L.2", "L.7"), takes=_silent_services(0x5A, 0x5B, 0x5C, 0x5D, 0x5E)))


@foreign("L.4", "L.5", way="sends")
def lss_refuses_with_a_code_of_the_maker_s(link, frame):
    if frame.can_id == 0x7E4 and frame.data[0] in (0x11, 0x13) and frame.data[1] == 1:
        return with_data(frame, bytes((frame.data[0], 0xFF, 7)) + bytes(5))
    return frame


# drive


@foreign("P.1", "P.2", "P.3", "P.4", "P.5", "P.6", "P.7", "P.9", expected=NOT, way="sends")
def a_drive_without_mains_has_a_fault(link, frame):
    if frame.can_id == 0x581 and frame.data[:4] == b"\x4b\x41\x60\0":
        return with_data(frame, frame.data[:4] + b"\x08\x02\0\0")
    return frame
