"""``python -m coulombus``, and the command ``coulombus``.

A signal may come during its imports.
"""

import atexit
import gc

from coulombus.system.stop_signals import at_once

YOUNG, MIDDLE, OLD = 10_000, 50, 20
"""Thresholds of the garbage collector: with Python's own (700, 10, 10) it runs again and again during
the imports.
"""


def main() -> None:
    """Run the command line; until a verb begins, a signal ends the process at once."""
    at_once()
    gc.set_threshold(YOUNG, MIDDLE, OLD)
    atexit.register(gc.freeze)  # else Python collects once more at the end, which a short verb's user waits for
    from coulombus.cli.main import main as verbs

    verbs(prog_name="coulombus")


if __name__ == "__main__":
    main()
