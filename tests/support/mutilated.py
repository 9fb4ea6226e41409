"""Files that somebody, or a disk, has mutilated."""

from collections.abc import Iterator

import numpy as np

PIECES = "[]{}=,.\"#\n'-0e9_ \u00e9\x00"


def mutilated(text: str, count: int, seed: int = 7) -> Iterator[str]:
    """Yield `count` copies of a text, each with a few characters lost, added or replaced."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        cut = list(text)
        for _ in range(random.integers(1, 4)):
            place = int(random.integers(len(cut)))
            cut[place : place + int(random.integers(0, 6))] = random.choice(list(PIECES), int(random.integers(0, 3)))
        yield "".join(cut)
