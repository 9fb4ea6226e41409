"""The page as it was at the last trip: what a page has seen is kept, and served again without bus and host.

The kept file is JSON: the rig's name, and for each axis its plots and its batches (`monitor.web.batch`)
in base64: that of the trip, and that with the final state.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from itertools import chain
from typing import Any, Protocol

import tornado.web
import tornado.websocket

from coulombus.monitor.web import WebError
from coulombus.monitor.web.batch import unpacked
from coulombus.monitor.web.guard import FORBIDDEN, Guarded

__all__ = ["LastData", "LastPage", "packed"]


class SeenPage(Protocol):
    """The page that is kept."""

    @property
    def rig_name(self) -> str:
        """The rig's name."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The names of the rig's axes."""

    def layout(self, name: str) -> dict[str, Any]:
        """Return the plots of an axis."""

    def last_batches(self, name: str) -> list[bytes]:
        """Return the batches of an axis."""


def packed(page: SeenPage) -> bytes:
    """Return the content of the kept file."""
    axes = {
        name: {
            "layout": page.layout(name),
            "batches": [base64.b64encode(batch).decode() for batch in page.last_batches(name)],
        }
        for name in page.axis_names
    }
    return json.dumps({"rig": page.rig_name, "axes": axes}).encode()


@dataclass
class LastPage:
    """A kept page, and the access token."""

    rig_name: str
    layouts: dict[str, dict[str, Any]]
    batches: dict[str, list[bytes]]
    token: str
    name: str = ""

    @classmethod
    def from_file(cls, content: bytes, token: str) -> LastPage:
        """Return the page of a kept file.

        Raises
        ------
        coulombus.monitor.web.WebError
            the file is not such a page
        """
        try:
            page = json.loads(content)
            layouts = {str(name): axis["layout"] for name, axis in page["axes"].items()}
            batches = {str(name): list(map(base64.b64decode, axis["batches"])) for name, axis in page["axes"].items()}
            for message in chain(*batches.values()):
                unpacked(message)
            if not batches:
                raise ValueError("it has no axis")
            return cls(str(page["rig"]), layouts, batches, token)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, struct.error) as error:
            raise WebError(f"the page of the last trip cannot be read: {error}; start the host again") from None

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The names of the rig's axes."""
        return tuple(self.batches)

    def axis(self, name: str) -> str:
        """Return the name of this axis, or of the first."""
        return name if name in self.batches else next(iter(self.batches))

    def layout(self, name: str) -> dict[str, Any]:
        """Return the plots of an axis, or of the first."""
        return self.layouts[self.axis(name)]

    async def stop(self) -> dict[str, Any]:
        """Answer that there is nothing to stop."""
        return {"ok": False, "text": "no host runs here: this page is what was seen at the last trip"}


class LastData(Guarded, tornado.websocket.WebSocketHandler):
    """WebSocket of a kept page: sends its batches; what the page says is ignored."""

    page: LastPage

    def prepare(self) -> None:
        """Refuse a request without the token, or from another page."""
        self.admit()
        if not self.from_the_page():
            raise tornado.web.HTTPError(FORBIDDEN)

    def check_origin(self, origin: str) -> bool:
        """Return True: `prepare` has checked it."""
        return True

    def open(self, *_: str, **__: str) -> None:
        """Send the batches of the axis."""
        for batch in self.page.batches[self.page.axis(self.get_query_argument("axis", ""))]:
            self.write_message(batch, binary=True)

    def on_message(self, message: str | bytes) -> None:
        """Ignore it."""
