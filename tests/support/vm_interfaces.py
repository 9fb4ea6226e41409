"""The CAN interfaces that the tests in tests/vm use, from COULOMBUS_TEST_CAN."""

from __future__ import annotations

import os
from pathlib import Path

INTERFACES = [name for name in os.environ.get("COULOMBUS_TEST_CAN", "").split(",") if name]
MISSING = [name for name in INTERFACES if not Path("/sys/class/net", name).exists()]
