"""``python -m tests.fuzz``: mutants of formats on demand; a table of what became of them, and the failing ones in a folder."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

if __name__ == "__main__":
    root = Path(__file__).resolve().parents[2]
    sys.path[:0] = [str(root), str(root / "tests")]
    from fuzz.campaign import campaign

    campaign(argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__))
