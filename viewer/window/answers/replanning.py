"""The planner, in a process of its own: planning a city holds Python's lock for seconds, in which no picture would be shown.

    python -m viewer.window.answers.replanning DATASET

reads questions from its standard input, a line of JSON each, ``{"cell": "0001-01", "index": 7}``, and writes a line for each to
its standard output: what :mod:`viewer.window.answers.explaining` says, or ``{"failed": "..."}``. It ends with its input.
:class:`Replanner` starts it with the first question and talks to it from a thread.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from mmi.dataset.reading import Dataset, open_dataset
from mmi.foundation.errors import MmiError
from viewer.window.answers.background import Background
from viewer.window.answers.explaining import Explainer

__all__ = ["Replanner", "answer_questions"]

_PREPARE = "prepare"
_NICENESS = 10
"""The process leaves the processor to whoever draws."""


class Replanner:
    """Has cells of a ``dataset`` planned again. To be closed."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset, self._background = dataset, Background("planning again")
        self._process: subprocess.Popen[str] | None = None

    def prepare(self) -> None:
        """Make ready for the first question. What goes wrong is told with that."""
        if self._refusal() is None:
            self._background.submit(lambda: self._asked({_PREPARE: True}))

    def ask(self, cell: str, index: int) -> Future[dict[str, Any]]:
        """Why object ``index`` has the part that it has in ``cell``: what :func:`explanation` says, as plain data.

        Where the cell cannot be planned again, ``why`` says so. Raises ParameterError where too many ask.
        """
        refusal = self._refusal()
        if refusal is not None:
            done: Future[dict[str, Any]] = Future()
            done.set_result(_unplanned(refusal))
            return done
        return self._background.submit(lambda: self._asked({"cell": cell, "index": index}))

    def close(self) -> None:
        """Give up at once."""
        self._background.close()
        if self._process is not None:
            _end(self._process)

    def _refusal(self) -> str | None:
        """Why nothing of this dataset can be planned again here, None where it can."""
        parameters = self._dataset.manifest.parameters
        if parameters.own_functions:
            named = ", ".join(parameters.own_functions)
            return f"The dataset was built with functions from outside the package ({named}), which the viewer does not run."
        if parameters.visibility != "horizon":
            return (
                "The build found out what is visible by drawing item buffers, which the viewer does not do again; "
                "inspect-layers does."
            )
        return None

    def _asked(self, question: dict[str, Any]) -> dict[str, Any]:
        """The answer of the process, which is started where it does not run."""
        process = self._process
        if process is not None and process.poll() is not None:
            _end(process)
            process = None
        if process is None:
            process = self._process = _started(self._dataset.path)
            if self._background.closed:
                _end(process)
        line = ""
        with suppress(OSError, ValueError):  # it has ended, or was closed
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(json.dumps(question) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        found: dict[str, Any] = json.loads(line) if line else {"failed": "the process that plans has ended"}
        if "failed" in found:
            why = str(found["failed"]).replace(f"{self._dataset.path}{os.sep}", "")
            return _unplanned(f"The cell cannot be planned again: {why}.")
        return found


def answer_questions(path: Path, questions: Iterable[str], answers: TextIO) -> None:
    """Answer each line of ``questions`` with a line in ``answers``, of the dataset at ``path``."""
    explainer: Explainer | None = None
    for line in questions:
        question = json.loads(line)
        try:
            explainer = Explainer(open_dataset(path)) if explainer is None else explainer
            if question.get(_PREPARE):
                explainer.prepare()
                found: dict[str, Any] = {}
            else:
                found = explainer.explain(question["cell"], question["index"])
        except MmiError as error:
            found = {"failed": str(error)}
        answers.write(json.dumps(found, allow_nan=False) + "\n")
        answers.flush()


def _started(path: Path) -> subprocess.Popen[str]:
    """The process, which finds what this one finds, and which Ctrl-C does not reach: who started it ends it."""
    places = os.pathsep.join(place or str(Path.cwd()) for place in sys.path)
    return subprocess.Popen(
        [sys.executable, "-m", "viewer.window.answers.replanning", str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": places},
        start_new_session=True,
    )


def _end(process: subprocess.Popen[str]) -> None:
    """End it, and close what leads to it."""
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        with suppress(OSError):
            assert stream is not None
            stream.close()


def _unplanned(answer: str) -> dict[str, Any]:
    return {"why": {"planned": False, "answer": answer}}


def _main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(OSError):
        os.nice(_NICENESS)
    answers, sys.stdout = sys.stdout, sys.stderr  # what a library prints is no answer
    answer_questions(Path(sys.argv[1]), sys.stdin, answers)


if __name__ == "__main__":
    _main()
