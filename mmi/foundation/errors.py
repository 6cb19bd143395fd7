"""The errors that users can cause or meet, as one tree.

    MmiError
    ├── CityError        the city cannot be read or used: file, object and what was expected
    ├── ParameterError   an option has no meaning, or contradicts another
    ├── CaptureError     OpenGL is missing, or could not render
    └── DatasetError     the dataset's folder or files are missing, foreign, damaged or not writable

Every message says what was expected, what was found and where. Programs print it as one line on stderr and exit with
status 2; a traceback that reaches a user is a bug.
"""

from __future__ import annotations

__all__ = ["CaptureError", "CityError", "DatasetError", "MmiError", "ParameterError"]


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
