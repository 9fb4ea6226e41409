"""A thread of a view, which runs within a ``with`` block."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from typing import Self

__all__ = ["ViewThread"]

END_S = 5.0


class ViewThread(ABC):
    """A thread of a view that ends with its ``with`` block."""

    def __init__(self, name: str) -> None:
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self._thread.join(timeout=END_S)

    @abstractmethod
    def _run(self) -> None:
        """Work until `stop` is set."""
