"""The TIME message (CiA 301, section 7.2.6).

Six bytes TIME_OF_DAY: milliseconds after midnight and days since 1984-01-01.

```
bit  47            32 31  28 27                    0
    +----------------+------+-----------------------+
    | days           |  0   | ms after midnight     |
    +----------------+------+-----------------------+
```
"""

from __future__ import annotations

from datetime import datetime, timedelta

__all__ = ["EPOCH", "LENGTH", "time_of_day", "time_word"]

EPOCH = datetime(1984, 1, 1)
LENGTH = 6

_MS_MASK, _DAYS_MASK = 0xFFFFFFF, 0xFFFF


def time_word(time: datetime) -> int:
    """Return the data of the TIME message for `time`, as a little-endian word; ValueError outside 1984 to
    2163.
    """
    passed = time - EPOCH
    if not 0 <= passed.days <= _DAYS_MASK:
        raise ValueError(f"{time} is outside what TIME can tell: 1984-01-01 to 2163-06-06")
    return passed.seconds * 1000 + passed.microseconds // 1000 | passed.days << 32


def time_of_day(word: int, elapsed_ns: int = 0) -> datetime:
    """Return the time of a TIME message, `elapsed_ns` after its reception."""
    return EPOCH + timedelta(
        days=word >> 32 & _DAYS_MASK, milliseconds=word & _MS_MASK, microseconds=elapsed_ns // 1000
    )
