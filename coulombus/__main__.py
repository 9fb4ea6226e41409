"""``python -m coulombus``, and the command ``coulombus``.

Its imports take a second, in which a signal may come.
"""

import atexit
import gc

from coulombus.wire.stopping import at_once

YOUNG = 10_000
"""Objects that are made before Python looks for circles among them. By its own 700 it does so 200
times while a verb is imported, a tenth of a start.
"""


def main() -> None:
    """Run the command line; until a verb begins, a signal ends the process at once."""
    at_once()
    gc.set_threshold(YOUNG)
    atexit.register(gc.freeze)  # Python looks for circles once more at the end, a fifth of a short verb's time
    from coulombus.verbs.main import main as verbs

    verbs(prog_name="coulombus")


if __name__ == "__main__":
    main()
