"""``python -m coulombus``, and the command ``coulombus``.

Its imports take a second, in which a signal may come.
"""

import atexit
import gc

from coulombus.system.stop_signals import at_once

YOUNG, MIDDLE, OLD = 10_000, 50, 20
"""How often Python looks for circles: among as many new objects, among those that this has left so
many times, among all when it has done that so often. By its own 700, 10, 10 it does so 200 times
while a verb is imported, a tenth of a start; a look among all of these takes another 50 ms.
"""


def main() -> None:
    """Run the command line; until a verb begins, a signal ends the process at once."""
    at_once()
    gc.set_threshold(YOUNG, MIDDLE, OLD)
    atexit.register(gc.freeze)  # Python looks for circles once more at the end, a fifth of a short verb's time
    from coulombus.cli.main import main as verbs

    verbs(prog_name="coulombus")


if __name__ == "__main__":
    main()
