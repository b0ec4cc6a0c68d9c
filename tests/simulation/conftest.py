"""The nominal vehicles of conf/vehicle and the surroundings that bind them."""

import pytest

from resc.build import build
from resc.term import Context


@pytest.fixture(scope="session")
def context_of(load_part):
    """`context_of("imp250")`: the control period of 20 ms and that vehicle."""

    def make(name, dt_s=0.02):
        vehicle = build(load_part("vehicle", name), "vehicle")
        return Context(dt_s=dt_s, resolution_m=0.1, vehicle=vehicle)

    return make
