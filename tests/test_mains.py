"""Every module run with `python -m` says how, and answers a wrong argument in a sentence."""

import importlib
import runpy
import sys

import pytest
from forked import ROOT, forked

GUARD = 'if __name__ == "__main__":'
MAINS = sorted(
    path for path in (ROOT / "resc").rglob("*.py") if GUARD in path.read_text(encoding="utf-8")
)
OF_HYDRA = ("bound.py", "transfer.py", "fly.py", "peer.py", "export.py")
"""Hydra reads their arguments, and a process does that once."""
WRONG = {
    "scores.py": ("nowhere",),
    "reproduction.py": ("nowhere",),
    "scene_picture.py": ("a.png", "nowhere.yaml"),
    "observation_picture.py": ("/dev/null/x",),
    "__main__.py": ("info", "nowhere"),
}
"""Arguments that have the right form."""


def run(path, *arguments, monkeypatch, capsys):
    """A module run as `python -m` does: exit status, output, errors."""
    if path.name in OF_HYDRA:
        importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        return forked(path, arguments)
    monkeypatch.setattr(sys, "argv", [str(path), *arguments])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(path), run_name="__main__")
    code, (out, errors) = ended.value.code, capsys.readouterr()
    return (1, out, code) if isinstance(code, str) else (code or 0, out, errors)


@pytest.mark.parametrize("path", MAINS, ids=lambda path: path.stem)
def test_help_is_printed_and_is_no_error(path, monkeypatch, capsys):
    code, out, errors = run(path, "--help", monkeypatch=monkeypatch, capsys=capsys)
    assert (code, errors) == (0, "")
    own = path.parent.name if path.stem == "__main__" else path.stem
    assert own in out or "resc-log" in out


@pytest.mark.parametrize("path", MAINS, ids=lambda path: path.stem)
def test_a_wrong_argument_is_answered_in_a_sentence(path, monkeypatch, capsys):
    given = WRONG.get(path.name, ("nowhere",))
    code, out, errors = run(path, *given, monkeypatch=monkeypatch, capsys=capsys)
    assert (code, out) == (1, "")
    assert errors.startswith("error: ")
    assert errors.count("\n") <= 1
    code, out, errors = run(path, "--bogus", monkeypatch=monkeypatch, capsys=capsys)
    assert code in (1, 2)
    assert out == ""
    assert "error: " in errors.splitlines()[-1]


def test_examples_of_a_scene_are_a_number(monkeypatch, capsys):
    path = ROOT / "resc" / "viewing" / "scene_picture.py"
    planned = str(ROOT / "conf" / "scene" / "planned.yaml")
    for number in ("0", "many"):
        given = ("a.png", planned, number)
        code, _, errors = run(path, *given, monkeypatch=monkeypatch, capsys=capsys)
        assert code == 2
        assert "examples" in errors
    other = str(ROOT / "conf" / "scene" / "free.yaml")
    _, _, errors = run(path, "a.png", other, monkeypatch=monkeypatch, capsys=capsys)
    assert "has no families; give the file of a planned scene" in errors
