"""The errors that users can cause or meet, as one tree.

    MmiError
    ├── CityError        the city cannot be read or used: file, object and what was expected
    ├── ParameterError   an option has no meaning, or contradicts another
    ├── CaptureError     OpenGL is missing, or could not render
    ├── DatasetError     the dataset's folder or files are missing, foreign, damaged or not writable
    └── FaultError       none of these: a worker process met what nobody foresaw

Every message says what was expected, what was found and where. Programs print it as one line on stderr and exit with
status 2, or with 1 where the fault is the program's own; a traceback that reaches a user is a bug.
"""

from __future__ import annotations

__all__ = ["CaptureError", "CityError", "DatasetError", "FaultError", "MmiError", "ParameterError", "one_line"]


class MmiError(Exception):
    """Anything that this project raises on purpose."""


class CityError(MmiError):
    """The city cannot be read or used."""


class ParameterError(MmiError):
    """An option has no meaning, or contradicts another."""


class CaptureError(MmiError):
    """OpenGL is missing, or could not render."""


class DatasetError(MmiError):
    """The dataset's folder or files are missing, foreign, damaged or not writable."""


class FaultError(MmiError):
    """The program is wrong, not what it was given: a worker process met what nobody foresaw."""


def one_line(text: str) -> str:
    """The words of a text in one line; characters in names from files that would command a terminal are written as codes."""
    words = " ".join(text.split())
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in words)
