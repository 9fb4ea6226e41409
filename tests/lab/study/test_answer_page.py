"""The page that asks: what it takes, what it refuses, and Stop."""

import asyncio
import http.client
import json
import threading
from urllib.parse import urlsplit

import pytest

from chromium import CHROMIUM, Browser
from coulombus.lab.study.page import AnswerPage
from coulombus.lab.study.trials import Trial
from coulombus.monitor.web import WebError

PAIR = Trial(1, 1, None, False, 2.2, 2.0, 1)
ONE = Trial(1, 1, None, False, 2.2, None, 0)


@pytest.fixture
def stops():
    return []


@pytest.fixture
def page(stops):
    with AnswerPage("Which one?", lambda: stops.append(1)) as one:
        yield one


def call(page, method, place, body=None, origin="own", token=None, host=None):
    port = urlsplit(page.url).port
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    headers = {} if origin is None else {"Origin": f"http://127.0.0.1:{port}" if origin == "own" else origin}
    headers |= {} if host is None else {"Host": host}
    try:
        line.request(method, f"/{token or page.token}/{place}", body, headers)
        answer = line.getresponse()
        return answer.status, answer.read()
    finally:
        line.close()


def asked(ask, *given):
    """Ask in a thread; return what comes, in a list, and the thread."""
    found = []
    thread = threading.Thread(target=lambda: found.append(ask(*given)))
    thread.start()
    return found, thread


def state(page, after):
    return json.loads(call(page, "GET", f"state?after={after}")[1])


def test_a_question_is_shown_and_its_answer_taken_once(page):
    found, thread = asked(page.ask, PAIR)
    shown = state(page, 0)
    assert (shown["kind"], shown["text"]) == ("choice", "Which one?")
    for wrong in ({"n": shown["n"], "answer": "3"}, {"n": shown["n"] - 1, "answer": "1"}, {"n": shown["n"]}, [], "1"):
        assert call(page, "POST", "answer", json.dumps(wrong))[0] == 409
    for wrong in (b"", b"\xff", b"{", b"[" * 900, b"1" * 2000):
        assert call(page, "POST", "answer", wrong)[0] == 409
    right = json.dumps({"n": shown["n"], "answer": "2"})
    assert call(page, "POST", "answer", right)[0] == 200
    thread.join()
    assert found == ["2"]
    assert call(page, "POST", "answer", right)[0] == 409


def test_a_magnitude_and_a_break_are_asked(page):
    found, thread = asked(page.ask, ONE)
    shown = state(page, 0)
    assert shown["kind"] == "number"
    assert call(page, "POST", "answer", json.dumps({"n": shown["n"], "answer": "nan"}))[0] == 409
    assert call(page, "POST", "answer", json.dumps({"n": shown["n"], "answer": "12.5"}))[0] == 200
    thread.join()
    assert found == ["12.5"]
    found, thread = asked(page.go_on, "Time for a break.")
    shown = state(page, shown["n"])
    assert (shown["kind"], shown["text"]) == ("go_on", "Time for a break.")
    assert call(page, "POST", "answer", json.dumps({"n": shown["n"], "answer": "y"}))[0] == 200
    thread.join()
    assert found == [True]


def test_stop_ends_the_display_and_the_question(page, stops):
    found, thread = asked(page.ask, PAIR)
    assert call(page, "POST", "stop")[0] == 200
    thread.join()
    assert found == [None]
    assert stops == [1]
    assert page.go_on("more?") is False


def test_who_has_no_token_or_is_another_site_is_sent_away(page, stops):
    assert call(page, "GET", "")[0] == 200
    assert call(page, "GET", "", token="x")[0] == 403
    for origin in (None, "http://evil.example", "null"):
        assert call(page, "POST", "stop", origin=origin)[0] == 403
    assert call(page, "POST", "other")[0] == 403
    assert call(page, "GET", "../../etc/passwd")[0] == 403
    assert call(page, "GET", "", host="evil.example")[0] == 421
    assert stops == []


def test_a_port_in_use_is_told(page):
    with pytest.raises(WebError, match="choose another with --port"):
        AnswerPage("?", lambda: None, urlsplit(page.url).port)


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_browser_answers_by_keys_buttons_and_the_field(page, stops, tmp_path):
    async def look():
        found, thread = asked(page.ask, PAIR)
        async with Browser(page.url, str(tmp_path)) as browser:
            await browser.until("document.querySelectorAll('#choices button').length === 2")
            await browser.evaluate("document.onkeydown(new KeyboardEvent('keydown', {key: '2'}))")
            await asyncio.to_thread(thread.join)
            again, thread = asked(page.ask, ONE)
            await browser.until("document.querySelector('#choices input') !== null")
            await browser.evaluate(
                "document.querySelector('#choices input').value = '7,5'; document.querySelector('#choices button').click()"
            )
            await browser.until("el('note').textContent === 'Your answer: 7.5. Thank you.'")
            await asyncio.to_thread(thread.join)
            more, thread = asked(page.go_on, "A break.")
            await browser.until("document.getElementById('text').textContent === 'A break.'")
            assert await browser.evaluate("el('note').textContent") == ""  # the last answer's
            await browser.evaluate("document.querySelector('#choices button').click()")
            await asyncio.to_thread(thread.join)
            last, thread = asked(page.ask, PAIR)
            await browser.until("document.querySelectorAll('#choices button').length === 2")
            await browser.evaluate("document.getElementById('stop').click()")
            await asyncio.to_thread(thread.join)
            assert browser.errors == []
        return found, again, more, last

    assert asyncio.run(look()) == (["2"], ["7.5"], [True], [None])
    assert stops == [1]
