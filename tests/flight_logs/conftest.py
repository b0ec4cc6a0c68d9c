"""Commands called in an empty folder."""

import pytest

from resc.log_command import main


@pytest.fixture
def call(capsys, monkeypatch, tmp_path):
    """Calls a command in an empty folder: exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def called(*arguments):
        with pytest.raises(SystemExit) as exit_:
            main([str(argument) for argument in arguments])
        code, (out, errors) = exit_.value.code, capsys.readouterr()
        return (1, out, code) if isinstance(code, str) else (int(code or 0), out, errors)

    return called
