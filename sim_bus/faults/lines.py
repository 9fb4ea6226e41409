"""Result lines of a fault file's faults and of the CAN controllers, for people."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

__all__ = ["injected_lines"]


def injected_lines(
    faults: Sequence[Mapping[str, Any]] | None, controllers: Mapping[str, Mapping[str, Any]] | None
) -> Iterator[str]:
    """Yield a line for each fault of a fault file, and for each CAN controller, including faults that never
    struck.
    """
    for fault in faults or ():
        bus = f"bus {fault['bus']}, " if "bus" in fault else ""
        if not fault["times"]:
            when = "never struck: what it waits for did not come"
        elif fault["times"] == 1:
            when = f"once, at {fault['first_s']:.6f} s"
        else:
            when = f"{fault['times']} times, from {fault['first_s']:.6f} s to {fault['last_s']:.6f} s"
        place = "injected" if fault["line"] is None else f"line {fault['line']}"
        yield f"fault {fault['kind']} ({bus}{place}): {when}"
    for name, c in (controllers or {}).items():
        counts = {
            "errors": sum(c["errors"].values()),
            "frames sent again": c["retransmissions"],
            "dropped": c["dropped"],
        }
        counts |= {"times error passive": c["passives"], "times bus-off": c["bus_offs"]}
        rest = "".join(f", {n} {what}" for what, n in counts.items() if n)
        yield f"controller {name}: {c['state'].upper()} (berr-counter tx {c['tec']} rx {c['rec']}){rest}"
