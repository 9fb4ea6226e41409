"""Which SDO answer is a frame that CAN delivered twice, and which is a second device's."""

from __future__ import annotations

import pytest

from coulombus.eds.sdo_answers import SdoAnswers
from coulombus.eds.sdo_frames import head

VALUE, OTHER, REFUSED = b"\x01\0\0\0", b"\x02\0\0\0", b"\0\0\x02\x06"


def upload(answers, index, *messages):
    """Ask for an object; return which of the answers go on with the transfer."""
    answers.ask(head(0x40, index, 0))
    return [answers.add_answer(message) for message in messages]


def test_the_same_frame_directly_behind_is_passed_over_and_no_second_device():
    answers = SdoAnswers()
    value = head(0x43, 0x1000, 0, VALUE)
    assert upload(answers, 0x1000, value, value) == [True, False]
    assert upload(answers, 0x1001, value, head(0x43, 0x1001, 0, VALUE)) == [False, True]
    assert not answers.duplicate_node_id


def test_an_object_that_is_read_again_has_the_same_answer_again():
    answers = SdoAnswers()
    for _ in range(20):
        assert upload(answers, 0x6041, head(0x43, 0x6041, 0, VALUE)) == [True]
    assert not answers.duplicate_node_id


def test_acknowledgements_of_blocks_may_be_alike_where_a_block_was_sent_between():
    answers, acknowledged = SdoAnswers(), b"\xa2\x03\x03" + bytes(5)
    answers.ask(head(0xC6, 0x2004, 0, VALUE))
    assert answers.add_answer(head(0xA4, 0x2004, 0, b"\x03"))
    for _ in range(3):
        answers.sent()
    assert [answers.add_answer(acknowledged), answers.add_answer(acknowledged)] == [True, False]
    answers.sent()
    assert not answers.add_answer(acknowledged)  # one segment was sent, three are acknowledged
    answers.sent()
    answers.sent()
    assert answers.add_answer(acknowledged)


def test_a_different_answer_to_one_request_is_a_second_device():
    for second in (head(0x43, 0x1000, 0, OTHER), head(0x80, 0x1000, 0, REFUSED)):
        answers = SdoAnswers()
        upload(answers, 0x1000, head(0x43, 0x1000, 0, VALUE), second)
        assert answers.duplicate_node_id
        assert answers.second == second


@pytest.mark.parametrize("first", [0, 4])
def test_second_answers_to_three_requests_in_a_row_are_those_of_a_second_device(first):
    answers, seconds = SdoAnswers(), []
    for number in range(8):
        value = head(0x43, 0x1000 + number, 0, VALUE)
        upload(answers, 0x1000 + number, value, *([value] if number >= first else []))
        seconds.append(answers.duplicate_node_id)
    assert seconds.index(True) == first + 2


def test_doubled_frames_now_and_then_are_no_second_device():
    answers = SdoAnswers()
    for number in range(300):
        value = head(0x43, 0x1000 + number, 0, VALUE)
        upload(answers, 0x1000 + number, value, *([value] if number % 3 else []))
    assert not answers.duplicate_node_id


def test_a_request_delivered_twice_may_have_two_answers():
    """A measured value changes; a second write may be refused."""
    answers = SdoAnswers()
    upload(answers, 0x6064, head(0x43, 0x6064, 0, VALUE), head(0x43, 0x6064, 0, OTHER))
    answers.ask(head(0x2B, 0x1400, 1, VALUE))
    assert answers.add_answer(head(0x60, 0x1400, 1))
    answers.ask(head(0x40, 0x1017, 0))
    assert not answers.add_answer(head(0x80, 0x1400, 1, REFUSED))
    assert answers.add_answer(head(0x4B, 0x1017, 0, VALUE))
    assert not answers.duplicate_node_id


def test_an_answer_about_another_object_is_kept_for_whoever_hears_no_other():
    answers, stray = SdoAnswers(), head(0x43, 0x1018, 1, VALUE)
    assert upload(answers, 0x1000, stray) == [False]
    assert answers.stray == stray
    assert upload(answers, 0x1001, head(0x43, 0x1001, 0, VALUE)) == [True]
    assert answers.stray == b""
