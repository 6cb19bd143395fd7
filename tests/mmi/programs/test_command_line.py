"""What programs share: progress where somebody watches, where nobody does, and where it is not wanted."""

import io
import sys

import pytest

from mmi.foundation.errors import MmiError
from mmi.foundation.plug_ins import plug_in
from mmi.foundation.progress import ProgressLog, silent
from mmi.programs.command_line import Parser, ProgressBar, run_program


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_output_that_is_redirected_gets_lines_and_no_bar(capsys):
    with ProgressBar("cells") as tell:
        assert isinstance(tell, ProgressLog)
        tell(0, 9, "street")
    assert capsys.readouterr().err == "", "it has only just begun"


def test_lines_go_to_standard_error_when_it_is_time(capsys):
    clock = iter([0.0, 1.0, 61.0])
    tell = ProgressLog("cells", clock=lambda: next(clock))
    tell(1, 9, "a")
    tell(3, 9, "b")
    told = capsys.readouterr()
    assert told.err == "cells: 3 of 9, about 3 min left (b)\n"
    assert told.out == ""


def test_a_terminal_gets_a_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setenv("TERM", "xterm-256color")
    with ProgressBar("cells") as tell:
        assert not isinstance(tell, ProgressLog)
        tell(3, 9, "Aleksanterinkatu")
    assert "Aleksanterinkatu" in sys.stderr.getvalue()


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_who_wants_it_quiet_gets_nothing(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream())
    with ProgressBar("cells", quiet=True) as tell:
        assert tell is silent
        tell(3, 9, "Aleksanterinkatu")
    assert sys.stderr.getvalue() == ""


def test_programs_import_from_the_current_folder_after_all_others(tmp_path, monkeypatch):
    """A dataset may have been built with a weight of somebody's own: whatever opens it looks there."""
    (tmp_path / "my_study.py").write_text("def weight(): ...\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one not in ("", str(tmp_path))])
    found = []
    with pytest.raises(SystemExit) as left:
        run_program(Parser(), [], lambda _: found.append(plug_in("my_study:weight").target), kept="nothing")
    assert (left.value.code, found) == (0, ["my_study:weight"])
    assert sys.path[-1] == str(tmp_path)


def test_a_message_is_one_line_and_commands_no_terminal(capsys):
    def refuse(_):
        raise MmiError("object a\nb\x1b[31m\u202ec\r\0: K\u00e4rntner Stra\u00dfe \u6771\u4eac")

    with pytest.raises(SystemExit) as left:
        run_program(Parser(prog="p"), [], refuse, kept="nothing")
    assert left.value.code == 2
    expected = "p: error: object a b\\x1b[31m\\u202ec \\x00: K\u00e4rntner Stra\u00dfe \u6771\u4eac\n"
    assert capsys.readouterr().err == expected


def test_a_file_name_that_commands_a_terminal_is_written_out(capsys):
    def refuse(_):
        raise FileNotFoundError(2, "No such file or directory", "a\x1b[2Jb\nc")

    with pytest.raises(SystemExit):
        run_program(Parser(prog="p"), [], refuse, kept="nothing")
    assert capsys.readouterr().err == "p: error: a\\x1b[2Jb c: No such file or directory\n"
