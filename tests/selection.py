"""Which of many inputs are left to ``scripts/test --slow``."""

import pytest

__all__ = ["with_slow"]


def with_slow(values, slow):
    """Parameters of a test or fixture, those that are among ``slow`` marked so."""
    return [pytest.param(value, marks=pytest.mark.slow) if value in slow else value for value in values]
