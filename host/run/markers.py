"""What persons mark in the recording while the host runs: keys of the terminal, ``coulombus mark``.

None of these markers can be taken for one of the run's own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

__all__ = ["StruckKeys", "marker_of"]

SAID, MOST_SAID, KEYS = "mark", 200, "123456789"
"""How such a marker begins; how long it is at most; the keys that set one."""


def marker_of(text: str) -> str:
    """Return the marker of what somebody says.

    Raises
    ------
    ValueError
        Nothing is said, too much, or what cannot be printed.
    """
    marker = f"{SAID} {text.strip()}"
    if not marker.isprintable() or not len(SAID) + 1 < len(marker) <= MOST_SAID:
        raise ValueError(f"expected a text of 1 to {MOST_SAID - len(SAID) - 1} printable characters")
    return marker


class StruckKeys:
    """Markers of the keys 1 to 9: the keys' thread strikes them, and the run takes them when it
    looks next.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._struck: deque[tuple[int, str]] = deque()

    def strike(self, strokes: bytes) -> None:
        """Keep what these strokes mark, with the present time."""
        for digit in strokes.decode("ascii", "replace"):
            if digit in KEYS:
                self._struck.append((self._now_ns(), marker_of(digit)))

    def take(self) -> Iterator[tuple[int, str]]:
        """Yield the time [ns] and the marker of each that has not been taken."""
        while self._struck:
            yield self._struck.popleft()
