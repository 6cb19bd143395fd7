"""Hypothesis draws the same examples in every run, so that a change is judged by what it changed.

``--hypothesis-profile explore`` draws new ones each time; ``scripts/test --slow`` does so.

A shell starts what it runs in the background with Ctrl-C ignored, and programs pass that on to those they start: tests of
Ctrl-C would wait in vain.
"""

import signal

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.register_profile("explore", print_blob=True)
settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
