"""How programs end, whatever is raised in them: one line, a status that says whose fault it was, and nothing before it."""

import logging
import re
import subprocess
import sys
import threading
import warnings

import pytest

from mmi.foundation.errors import CityError, FaultError
from mmi.programs.command_line import Parser, run_program
from mmi.programs.endings import ending_of, fault_line

FAULT = re.compile(
    r"p: error: (.+) \(\w+\.py, line \d+\); this is a fault of the program, please report this line and the command: "
    r"multi-mesh-impostors \S+, Python 3\.[\d.]+; --debug prints the traceback\n"
)


def ended(capsys, program, *arguments):
    """(exit status, standard output, standard error) of a program that is a function of its options."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as left:
        run_program(Parser(prog="p"), list(arguments), program, kept="all is kept")
    return left.value.code, *capsys.readouterr()


def raises(error):
    def program(_):
        raise error

    return program


class HeldBackError(BaseException):
    """What derives from no Exception, as some libraries' do."""


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyError("a table without this row"), "KeyError: 'a table without this row'"),
        (ValueError("two\nlines\x1b[31m"), "ValueError: two"),
        (ZeroDivisionError(), "ZeroDivisionError"),
        (RecursionError("too deep"), "RecursionError: too deep"),
        (AssertionError(), "AssertionError"),
        (HeldBackError("held"), "HeldBackError: held"),
        (RuntimeError("x" * 1_000_000), f"RuntimeError: {'x' * 1986}..."),
        (UnicodeEncodeError("ascii", "ü", 0, 1, "no such letter"), r"UnicodeEncodeError: .*"),
    ],
)
def test_a_fault_of_the_program_says_so_and_how_to_report_it(capsys, error, said):
    status, out, err = ended(capsys, raises(error))
    assert (status, out) == (1, "")
    told = FAULT.fullmatch(err)
    assert told, err
    assert told[1] == said or re.fullmatch(said, told[1])


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (CityError("a.osm: no"), 2, "error: a.osm: no"),
        (
            FaultError("out: cell 0: KeyError; this is a fault of the program"),
            1,
            "error: out: cell 0: KeyError; this is a fault",
        ),
        (MemoryError(), 2, "error: memory ran out; expected a machine with more of it, or less to do"),
        (MemoryError("Unable to allocate 3 TiB"), 2, "error: memory ran out (Unable to allocate 3 TiB); expected"),
        (KeyboardInterrupt(), 130, "interrupted; all is kept"),
        (PermissionError(13, "Permission denied", "a"), 2, "error: a: Permission denied"),
        (PermissionError(13, "Permission denied", b"a\xff"), 2, "error: a\\udcff: Permission denied"),
        (OSError("no more"), 2, "error: OSError: no more"),
        (BrokenPipeError(32, "Broken pipe"), 2, "error: Broken pipe"),  # standard output is read: it was another one
        (SystemExit("no good"), 1, "error: no good"),
    ],
)
def test_whose_fault_it_was_is_told_by_the_status(capsys, error, status, line):
    found, out, err = ended(capsys, raises(error))
    assert (found, out) == (status, "")
    assert err.startswith(f"p: {line}")
    assert err.count("\n") == 1


def test_who_wants_it_gets_the_traceback_before_the_line(capsys):
    for error, status in ((KeyError("row"), 1), (CityError("a.osm: no"), 2), (KeyboardInterrupt(), 130)):
        found, _, err = ended(capsys, raises(error), "--debug")
        lines = err.splitlines()
        assert (found, lines[0]) == (status, "Traceback (most recent call last):")
        assert "in program" in err
        assert lines[-1].startswith("p: ")
    assert ended(capsys, lambda _: None, "--debug") == (0, "", "")


def chatty(_):
    warnings.warn("a library is unsure", RuntimeWarning, stacklevel=1)
    logging.getLogger("a.library").error("what a library logs")
    thread = threading.Thread(target=lambda: {}["row"])
    thread.start()
    thread.join()
    raise CityError("a.osm: no")


@pytest.mark.filterwarnings("default::RuntimeWarning")
@pytest.mark.filterwarnings("default::pytest.PytestUnhandledThreadExceptionWarning")
def test_what_libraries_say_does_not_come_before_the_line(capsys):
    before = warnings.showwarning, threading.excepthook, sys.unraisablehook, list(logging.getLogger().handlers)
    status, _, err = ended(capsys, chatty)
    told = err.splitlines()
    assert (status, told[-1], len(told)) == (2, "p: error: a.osm: no", 2)
    assert told[0].startswith("p: error: KeyError: 'row' (test_endings.py, line"), "of the thread, which is ours"
    assert before == (warnings.showwarning, threading.excepthook, sys.unraisablehook, logging.getLogger().handlers)


SCRIPT = """
import logging, sys, warnings
from mmi.foundation.errors import CityError
from mmi.programs.command_line import Parser, run_program

class Grudge:
    def __del__(self):
        raise KeyError("a finalizer")

def program(_):
    warnings.warn("a library is unsure", RuntimeWarning)
    logging.getLogger("a.library").error("what a library logs")
    Grudge()
    print("some output")
    raise {}

run_program(Parser(prog="p"), sys.argv[1:], program, kept="nothing")
"""


@pytest.mark.parametrize(
    ("raised", "status", "line"),
    [("CityError('no')", 2, "p: error: no"), ("KeyError('row')", 1, "p: error: KeyError: 'row' (")],
)
def test_a_process_of_its_own_says_one_line(raised, status, line):
    """Where pytest does not catch warnings and logs itself."""
    done = subprocess.run([sys.executable, "-c", SCRIPT.format(raised)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (status, "some output\n", 1)
    assert done.stderr.startswith(line)
    loud = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(raised), "--debug"], capture_output=True, text=True, check=False
    )
    assert loud.returncode == status
    for said in ("a library is unsure", "what a library logs", "a finalizer", "Traceback", line):
        assert said in loud.stderr


def test_an_error_without_a_traceback_has_a_line_too():
    assert ending_of(KeyError("row"), kept="").line == fault_line(KeyError("row"))
    assert fault_line(KeyError("row")).startswith("error: KeyError: 'row'; this is a fault of the program")


def test_a_program_can_leave_with_a_status_of_its_own(capsys):
    assert ended(capsys, raises(SystemExit(3))) == (3, "", "")
    assert ended(capsys, raises(SystemExit())) == (0, "", "")
