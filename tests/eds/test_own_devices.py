"""Whether a device is that of an EDS file, by 1018h."""

from pathlib import Path

import pytest

from coulombus.eds.own_devices import PRODUCTS, VENDOR_ID, is_another
from coulombus.eds.reader import read_eds

MOTOR = Path(__file__).parents[2] / "eds" / "motor.eds"


@pytest.mark.parametrize(
    ("product", "identity", "another"),
    [
        (PRODUCTS["motor"], (VENDOR_ID, PRODUCTS["motor"]), False),
        (PRODUCTS["motor"], (VENDOR_ID, 7), True),
        (PRODUCTS["motor"], (7, PRODUCTS["motor"]), True),
        (PRODUCTS["motor"], (0, 0), False),  # it says nothing
        (0, (VENDOR_ID, 7), False),  # the file says nothing
        (0, (7, 7), True),
    ],
)
def test_another_device_has_another_identity_where_file_and_device_have_one(tmp_path, product, identity, another):
    text = MOTOR.read_text().replace(f"DefaultValue=0x{PRODUCTS['motor']:08X}", f"DefaultValue=0x{product:08X}")
    path = tmp_path / "motor.eds"
    path.write_text(text)
    assert is_another(read_eds(path), identity) is another
