"""Hypothesis draws the same examples in every run, so that a change is judged by what it changed.

``--hypothesis-profile explore`` draws new ones each time; ``scripts/test --slow`` does so.
"""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.register_profile("explore", print_blob=True)
settings.load_profile("repeatable")
