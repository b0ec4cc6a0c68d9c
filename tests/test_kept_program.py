"""Programs that the next process takes up: the same numbers, and never those of something else."""

import pytest
import torch
from straight_line import Line

from resc import kept_program
from resc.kept_program import compiled, facts_of


@pytest.fixture
def programs(tmp_path, monkeypatch):
    """The folder of kept programs, with nothing in it; the sources are those that were imported."""
    monkeypatch.setattr(kept_program, "_folder", lambda: tmp_path)
    monkeypatch.setattr(kept_program, "_is_as_imported", lambda: True)
    torch.compiler.reset()
    return tmp_path


def refuse(*_):
    """In place of a compiler."""
    raise AssertionError("it was compiled again")


def read(programs):
    return sorted(path.name for path in programs.iterdir())


X = torch.tensor([1.0, 2.0])


def test_a_program_is_kept_and_taken_up(programs, monkeypatch):
    assert compiled(Line(3.0).at, "line")(X).tolist() == [4, 7]
    (name,) = read(programs)
    monkeypatch.setattr(torch, "compile", lambda function, **_: refuse)
    assert compiled(Line(3.0).at, "line")(X).tolist() == [4, 7]
    assert read(programs) == [name]


def test_an_object_with_another_number_is_compiled_afresh(programs):
    compiled(Line(3.0).at, "line")(X)
    assert compiled(Line(5.0).at, "line")(X).tolist() == [6, 11]


def test_a_number_that_changes_between_two_calls_counts(programs):
    line = Line(3.0)
    call = compiled(line.at, "line")
    call(X)
    line.slope = 5.0
    assert call(X).tolist() == [6, 11]


def test_other_shapes_are_compiled_afresh(programs):
    call = compiled(Line(3.0).at, "line")
    call(X)
    assert call(torch.tensor([2.0])).tolist() == [7]


@pytest.mark.parametrize("changed", ["_source", "_machine"])
def test_other_sources_or_machines_have_programs_of_their_own(programs, monkeypatch, changed):
    compiled(Line(3.0).at, "line")(X)
    monkeypatch.setattr(kept_program, changed, lambda: "another")
    compiled(Line(3.0).at, "line")(X)
    assert len(read(programs)) == 2


def test_every_source_file_counts(tmp_path, monkeypatch):
    (tmp_path / "constants.py").write_text("G = 9.81")
    monkeypatch.setattr(kept_program, "PACKAGE", tmp_path)
    before = kept_program._source.__wrapped__()
    (tmp_path / "constants.py").write_text("G = 9.82")
    assert kept_program._source.__wrapped__() != before


def test_a_file_edited_while_the_process_starts_keeps_nothing(tmp_path, monkeypatch):
    (tmp_path / "constants.py").write_text("G = 9.81")
    monkeypatch.setattr(kept_program, "PACKAGE", tmp_path)
    assert not kept_program._is_as_imported()
    assert compiled(Line(3.0).at, "line").facts == ""


def test_what_cannot_be_read_is_compiled_as_ever(programs):
    compiled(Line(3.0).at, "line")(X)
    (path,) = programs.iterdir()
    path.write_bytes(b"damaged")
    assert compiled(Line(3.0).at, "line")(X).tolist() == [4, 7]


def test_facts_are_all_parts_of_a_configuration_and_none_with_code_of_others():
    def facts(weight, seed=1, allowed=(), device="cpu"):
        parts = {"seed": seed, "reward": {"time": {"weight": weight}}}
        return facts_of(parts, allowed=allowed, device=device)

    assert facts(1.0) == facts(1.0, seed=2)
    assert facts(1.0) != facts(2.0)
    assert not facts(1.0, allowed=["mine."])
    assert not facts(1.0, device="cuda")


def test_where_nothing_can_be_written_it_is_compiled_as_ever(tmp_path, monkeypatch):
    (tmp_path / "taken").touch()
    monkeypatch.setattr(kept_program, "_folder", lambda: (tmp_path / "taken" / "resc").mkdir())
    monkeypatch.setattr(kept_program, "_is_as_imported", lambda: True)
    assert compiled(Line(3.0).at, "line")(X).tolist() == [4, 7]
