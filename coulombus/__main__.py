"""``python -m coulombus``, and the command ``coulombus``.

Its imports take a second, in which a signal may come.
"""

from coulombus.wire.stopping import at_once


def main() -> None:
    """Run the command line; until a verb begins, a signal ends the process at once."""
    at_once()
    from coulombus.verbs.main import main as verbs

    verbs(prog_name="coulombus")


if __name__ == "__main__":
    main()
