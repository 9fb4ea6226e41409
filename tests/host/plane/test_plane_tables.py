"""Tables of several laws in the plane in one rig file."""

from __future__ import annotations

import pytest

from coulombus.host.laws.plane.plane_laws import PLANE_LAWS
from coulombus.host.plane.plane_host import load_plane
from coulombus.rigs.rig import RigError, load_rig


@pytest.mark.parametrize("law", sorted(PLANE_LAWS))
def test_the_table_of_another_law_in_the_plane_may_stay(law):
    model = load_plane(load_rig("plane", (f"law.function={law}",)), "hybrid")
    assert model is not None
    assert model.law.name == law


def test_the_table_of_another_law_is_checked():
    with pytest.raises(RigError, match=r"law\.plane_wall\.K_N_m"):
        load_plane(load_rig("plane", ("law.plane_wall.K_N_m=-1",)), "hybrid")


def test_a_misspelt_table_is_reported():
    with pytest.raises(RigError, match="there is no law 'plane_wal'; did you mean 'plane_wall'"):
        load_plane(load_rig("plane", ("law.plane_wal.K_N_m=1",)), "hybrid")
