"""A search that every test of methods may start from."""

import pytest

from resc.planning.searches.search import Search


@pytest.fixture
def unit_search() -> Search:
    """Search on cells of 1 m without clearance, so that occupied and blocked are the same."""
    return Search(clearance_m=0.0, resolution_m=1.0)
