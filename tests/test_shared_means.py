"""Means over processes through memory that they share."""

import os
import tempfile
from pathlib import Path

import pytest
import torch
from ranked import together

from resc import ranks

LENGTH = 1000


def of_rank(rank, turn):
    return torch.randn(LENGTH, generator=torch.Generator().manual_seed(100 * turn + rank))


def several_means():
    """What each rank finds in twenty rounds, and what is left of the folder."""
    found = []
    for turn in range(20):
        vector = of_rank(ranks.rank(), turn)
        ranks.average_([vector[:300], vector[300:]])
        found.append(vector)
    assert ranks._shared_means(LENGTH) is not None
    return torch.stack(found)


def one_ends():
    """The sentence of the first rank once the second has ended."""
    ranks.average_([torch.zeros(LENGTH)])
    if ranks.rank() == 1:
        ranks._shared_means(LENGTH).close()
        return ""
    try:
        ranks.average_([torch.zeros(LENGTH)])
    except ranks.LostRankError as error:
        return str(error)


def without_room(whose):
    """Means where some find no memory: by messages."""

    def full(*_):
        raise OSError("No space left on device")

    if ranks.rank() in whose:
        os.posix_fallocate = full  # in a process of its own
    vector = of_rank(ranks.rank(), 0)
    ranks.average_([vector])
    assert ranks._shared_means(LENGTH) is None
    return vector


def of_doubles():
    """Means of numbers that the memory cannot hold exactly: by messages."""
    vector = of_rank(ranks.rank(), 0).double() / 3
    ranks.average_([vector])
    return vector


def test_doubles_keep_their_precision():
    expected = (of_rank(0, 0).double() / 3 + of_rank(1, 0).double() / 3) / 2
    for found in together(of_doubles):
        torch.testing.assert_close(found, expected, rtol=1e-14, atol=1e-15)


def test_three_processes_find_the_same_means_and_leave_no_file():
    before = left()
    expected = torch.stack(
        [torch.stack([of_rank(rank, turn) for rank in range(3)]).mean(0) for turn in range(20)]
    )
    found = together(several_means, count=3)
    torch.testing.assert_close(found[0], expected)
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])
    assert left() == before


def test_a_process_that_ends_is_noticed():
    assert "has ended" in together(one_ends)[0]


@pytest.mark.parametrize("whose", [(0, 1), (0,), (1,)])
def test_without_room_messages_carry_the_means(whose):
    found = together(without_room, whose)
    torch.testing.assert_close(found[0], (of_rank(0, 0) + of_rank(1, 0)) / 2)
    assert torch.equal(*found)


def left():
    """Folders that shared memory has left."""
    places = (Path("/dev/shm"), Path(tempfile.gettempdir()))
    return {path for place in places for path in place.glob("resc-*")}
