"""``python -m coulombus``: the command line."""

from coulombus.verbs.main import main

if __name__ == "__main__":
    main(prog_name="coulombus")
