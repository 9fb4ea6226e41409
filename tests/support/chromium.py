"""A headless Chromium, asked over the DevTools protocol; no library but Tornado is needed.

`Browser.evaluate` asks the page a JavaScript expression; `until` asks until it is true.
"""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import subprocess
from typing import Any

from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    *("--remote-debugging-port=0", "--disable-background-networking", "--disable-component-update"),
    *("--hide-scrollbars", "--mute-audio", "--remote-allow-origins=*"),
)


class Browser:
    """One tab; `requested` are the addresses that it asked for, `errors` what its console told."""

    def __init__(self, url: str, directory: str, size: tuple[int, int] = (1280, 720), dark: bool = False) -> None:
        self.url, self.directory, self.size, self.dark = url, directory, size, dark
        self.requested: list[str] = []
        self.errors: list[str] = []
        self._numbers = 0
        self._answers: dict[int, asyncio.Future[Any]] = {}

    async def __aenter__(self) -> Browser:
        size = f"--window-size={self.size[0]},{self.size[1]}"
        self.process = subprocess.Popen(
            [CHROMIUM, *FLAGS, size, f"--user-data-dir={self.directory}", "about:blank"],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        try:
            place = await asyncio.to_thread(self._place)
            port = place.partition("ws://")[2].partition("/")[0]
            request = HTTPRequest(f"http://{port}/json/new?about:blank", method="PUT", body="")
            tab = json.loads((await AsyncHTTPClient().fetch(request)).body)
            self._socket = await websocket_connect(tab["webSocketDebuggerUrl"], max_message_size=1 << 26)
            self._listener = asyncio.create_task(self._listen())
            for domain in ("Network", "Page", "Runtime", "Log"):
                await self.call(f"{domain}.enable")
            width, height = self.size
            metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            await self.call("Emulation.setDeviceMetricsOverride", **metrics)
            scheme = {"name": "prefers-color-scheme", "value": "dark" if self.dark else "light"}
            await self.call("Emulation.setEmulatedMedia", features=[scheme])
            await self.call("Page.navigate", url=self.url)
        except BaseException:
            await self.__aexit__()
            raise
        return self

    def _place(self) -> str:
        lines = []
        for line in self.process.stderr:
            lines.append(line)
            if "DevTools listening on" in line:
                return line.strip()
        raise OSError("chromium did not start: " + "".join(lines[-5:]))

    async def __aexit__(self, *_: object) -> None:
        if hasattr(self, "_listener"):
            self._socket.close()
            await asyncio.wait({self._listener}, timeout=10)  # until the browser has closed it, too
            self._listener.cancel()
        self.process.kill()
        await asyncio.to_thread(self.process.wait)
        self.process.stderr.close()

    async def _listen(self) -> None:
        while (text := await self._socket.read_message()) is not None:
            found = json.loads(text)
            if "id" in found:
                future = self._answers.pop(found["id"])
                if not future.done():
                    future.set_result(found)
            elif found["method"] == "Network.requestWillBeSent":
                self.requested.append(found["params"]["request"]["url"])
            elif found["method"] == "Network.webSocketCreated":
                self.requested.append(found["params"]["url"])
            elif found["method"] == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(found["params"]["exceptionDetails"])[:500])
            elif found["method"] == "Log.entryAdded" and found["params"]["entry"]["level"] == "error":
                self.errors.append(found["params"]["entry"]["text"])

    async def call(self, method: str, **parameters: Any) -> Any:
        """Ask the browser; return its answer."""
        self._numbers += 1
        future = self._answers[self._numbers] = asyncio.get_running_loop().create_future()
        await self._socket.write_message(json.dumps({"id": self._numbers, "method": method, "params": parameters}))
        answer = await asyncio.wait_for(future, 30)
        assert "error" not in answer, answer
        return answer["result"]

    async def evaluate(self, expression: str) -> Any:
        """Return the value of an expression of the page."""
        found = await self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    async def text(self, signal: str) -> str | None:
        """Return the text of the element that shows a signal."""
        return await self.evaluate(f"document.querySelector('[data-signal=\"{signal}\"]')?.textContent")

    async def until(self, expression: str, seconds: float = 30.0) -> Any:
        """Ask until an expression is true, for so long at most."""
        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        asked = f"(() => {{ try {{ return Boolean({expression}) }} catch {{ return false }} }})()"  # while it is loaded, too
        while not (found := await self.evaluate(asked)):
            assert loop.time() < end, f"{expression} has not come true; console: {self.errors}"
            await asyncio.sleep(0.05)
        return found

    async def press(self, key: str, code: int, text: str = "") -> None:
        """Press a key; `text` is what it types."""
        for kind in ("keyDown", "keyUp"):
            more = {"text": text} if text and kind == "keyDown" else {}
            await self.call("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=code, **more)

    async def screenshot(self, path: str) -> None:
        """Write a picture of the page."""
        found = await self.call("Page.captureScreenshot", format="png")
        with open(path, "wb") as file:
            file.write(base64.b64decode(found["data"]))
