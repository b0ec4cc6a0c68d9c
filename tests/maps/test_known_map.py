"""Known maps: two renderings that agree to the bit, and a distance field that follows them."""

import pytest
import torch

from resc.maps.constants import TRUNCATION_M
from resc.maps.distance_transform import distance_transform
from resc.maps.known_map import (
    UNKNOWN,
    Beams,
    Evidence,
    reveal,
    reveal_in_torch,
    scan,
    scan_in_torch,
)
from resc.maps.movers import covered

RELEASED = Evidence(hit=6, miss=-6, least=-20, most=22, occupied=14)
QUICK = Evidence(hit=22, miss=-11, least=-20, most=22, occupied=14)
COUNT, HEIGHT, WIDTH, CELL_M = 24, 90, 110, 0.1


@pytest.fixture(scope="module")
def field():
    """Random blocks on maps of two sizes, one of them smaller than its array."""
    generator = torch.Generator().manual_seed(0)
    seeds = torch.rand(4, 1, HEIGHT, WIDTH, generator=generator) < 0.006
    occupied = torch.nn.functional.max_pool2d(seeds.float(), 5, 1, 2)[:, 0] > 0
    index = torch.randint(4, (COUNT, 1), generator=generator)
    size = torch.tensor([[11.0, 9.0], [11.0, 9.0], [8.0, 7.0], [8.0, 7.0]])
    truth = distance_transform(occupied, CELL_M, TRUNCATION_M)
    return index, truth, torch.tensor([[-5.0, -4.0]]).expand(4, 2).contiguous(), size


def unknown():
    return (
        torch.full((COUNT, HEIGHT, WIDTH), UNKNOWN, dtype=torch.int8),
        torch.full((COUNT, HEIGHT, WIDTH), TRUNCATION_M),
    )


def random_beams(generator, here, *, error=1.0):
    angle = 6.28 * torch.rand(COUNT, 1, generator=generator) + torch.linspace(-1, 1, 70)
    direction = torch.stack((angle.cos(), angle.sin()), -1)
    length = 5 * (torch.rand(COUNT, 70, generator=generator) > 0.1).float()
    noise = error * torch.randn(2, COUNT, 70, generator=generator)
    return Beams(here, direction, length, 0.02 * noise[0], 0.01 * noise[1])


@pytest.mark.parametrize("model", [RELEASED, QUICK], ids=["released", "quick"])
def test_scans_agree_with_torch_and_the_field_with_the_transform(field, model):
    generator = torch.Generator().manual_seed(1)
    known, plainly = unknown(), unknown()
    here = torch.rand(COUNT, 2, generator=generator) * 7 - 4
    freed = False
    for _ in range(8):
        here = here + 0.2 * torch.randn(COUNT, 2, generator=generator)
        beams = random_beams(generator, here)
        due = torch.rand(COUNT, 1, generator=generator) < 0.7
        before = known[0] >= model.occupied
        scan(field, beams, due, *known, model, CELL_M)
        scan_in_torch(field, beams, due, *plainly, list(model), CELL_M)
        assert torch.equal(known[0], plainly[0])
        assert torch.equal(known[1], plainly[1])
        there = known[0] >= model.occupied
        freed = freed or bool((before & ~there).any())
        assert torch.equal(known[1], distance_transform(there, CELL_M, TRUNCATION_M))
    assert there.sum() > 100
    assert freed or model is RELEASED


def test_what_is_revealed_agrees_with_torch_and_with_the_truth(field):
    generator = torch.Generator().manual_seed(2)
    known, plainly = unknown(), unknown()
    for _ in range(4):
        here = torch.rand(COUNT, 2, generator=generator) * 11 - 5
        due = torch.rand(COUNT, 1, generator=generator) < 0.7
        reveal(field, here, 2.5, due, *known, RELEASED, CELL_M)
        reveal_in_torch(field, here, 2.5, due, *plainly, list(RELEASED), CELL_M)
        assert torch.equal(known[0], plainly[0])
        assert torch.equal(known[1], plainly[1])
    there, seen = known[0] >= RELEASED.occupied, known[0] != UNKNOWN
    assert torch.equal(known[1], distance_transform(there, CELL_M, TRUNCATION_M))
    index, truth, *_ = field
    assert torch.equal(there[seen], (truth[index[:, 0]] <= 0)[seen])


FADING = RELEASED._replace(hit=16, fade=3)


def random_movers(generator):
    """Boxes and round ones, some of them beyond the map or smaller than a cell."""
    outline = torch.rand(COUNT, 6, 4, generator=generator) * torch.tensor([12.0, 10.0, 0.6, 0.6])
    outline[:, :, :2] -= 5.5
    outline[:, ::2, 3] = 0
    outline[:, 5] = torch.tensor([1e6, 1e6, 0.0, 0.0])
    return outline


@pytest.mark.parametrize("way", ["scan", "reveal"])
def test_with_movers_and_fading_both_renderings_agree(field, way):
    generator = torch.Generator().manual_seed(4)
    known, plainly = unknown(), unknown()
    faded = False
    for _ in range(8):
        here = torch.rand(COUNT, 2, generator=generator) * 7 - 4
        due = torch.rand(COUNT, 1, generator=generator) < 0.7
        movers = random_movers(generator)
        before = known[0].clone()
        if way == "scan":
            beams = random_beams(generator, here)
            scan(field, beams, due, *known, FADING, CELL_M, movers)
            scan_in_torch(field, beams, due, *plainly, list(FADING), CELL_M, movers)
        else:
            reveal(field, here, 2.5, due, *known, FADING, CELL_M, movers)
            reveal_in_torch(field, here, 2.5, due, *plainly, list(FADING), CELL_M, movers)
        assert torch.equal(known[0], plainly[0])
        assert torch.equal(known[1], plainly[1])
        faded = faded or bool((before - known[0] == 3).any())
        there = known[0] >= FADING.occupied
        assert torch.equal(known[1], distance_transform(there, CELL_M, TRUNCATION_M))
        assert torch.equal(known[0][~due[:, 0]], before[~due[:, 0]])
    assert faded


def test_what_is_revealed_shows_movers_where_they_are(field):
    known, everywhere = unknown(), torch.ones(COUNT, 1, dtype=torch.bool)
    movers = random_movers(torch.Generator().manual_seed(5))
    reveal(field, torch.zeros(COUNT, 2), 2.5, everywhere, *known, RELEASED, CELL_M, movers)
    index, truth, corner, _ = field
    moving = covered(movers, corner[index[:, 0]], (HEIGHT, WIDTH), CELL_M)
    seen = known[0] != UNKNOWN
    solid = (truth[index[:, 0]] <= 0) | moving
    assert torch.equal((known[0] >= RELEASED.occupied)[seen], solid[seen])
    assert (moving & ~(truth[index[:, 0]] <= 0) & seen).sum() > 100


def test_rows_that_are_not_due_stay_as_they_are(field):
    generator = torch.Generator().manual_seed(3)
    known = unknown()
    due = torch.zeros(COUNT, 1, dtype=torch.bool)
    beams = random_beams(generator, torch.zeros(COUNT, 2))
    scan(field, beams, due, *known, RELEASED, CELL_M)
    reveal(field, beams.here, 3.0, due, *known, RELEASED, CELL_M)
    assert all(torch.equal(a, b) for a, b in zip(known, unknown(), strict=True))


def wall():
    """A wall of one cell at x = 3 m, seen from (0, 0) on a map of 9 x 9 m."""
    occupied = torch.zeros(1, 90, 90, dtype=torch.bool)
    occupied[0, :, 75] = True
    truth = distance_transform(occupied, CELL_M, TRUNCATION_M)
    corner, size = torch.tensor([[-4.5, -4.5]]), torch.tensor([[9.0, 9.0]])
    return torch.zeros(1, 1, dtype=torch.int64), truth, corner, size


def test_one_beam_frees_what_it_passes_and_marks_where_it_ends_once():
    evidence = torch.full((1, 90, 90), UNKNOWN, dtype=torch.int8)
    esdf = torch.full((1, 90, 90), TRUNCATION_M)
    zero = torch.zeros(1, 3)  # three times the same beam: a cell counts once in a scan
    beams = Beams(
        torch.tensor([[0.01, 0.01]]),
        torch.tensor([[[1.0, 0.0]]]).expand(1, 3, 2).contiguous(),
        torch.full((1, 3), 5.0),
        zero,
        zero,
    )
    scan(wall(), beams, torch.ones(1, 1, dtype=torch.bool), evidence, esdf, RELEASED, CELL_M)
    row = evidence[0, 45]
    assert (row[45:74] == -6).all()
    assert row[75] == 6
    assert (row[76:] == UNKNOWN).all()
    assert (row[:45] == UNKNOWN).all()
    assert (evidence != UNKNOWN).sum() <= 31
