"""Mutants of many formats: the table of what became of them and what they cost, and the folder of those that failed."""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

from fuzz.formats import FORMATS, mutant_of
from fuzz.pool import FAILURES, OUTCOMES, Tried, tried
from fuzz.seeds import read_seeds


def campaign(parser: argparse.ArgumentParser) -> None:
    """Parse what was asked for, do it, and exit with 1 where anything failed."""
    parser.add_argument("--format", action="append", choices=[*FORMATS], help="a format (again for more; default: all)")
    parser.add_argument("--mutants", type=int, default=300, metavar="N", help="mutants of each format (default: 300)")
    parser.add_argument("--run", type=int, default=0, metavar="N", help="number of the run: others draw other mutants")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first mutant (default: 0)")
    parser.add_argument("--failures", type=Path, default=Path("fuzz-failures"), help="folder for failing mutants")
    told = parser.parse_args()
    warnings.simplefilter("ignore")
    names = told.format or [*FORMATS]
    seeds = read_seeds(names)
    print(f"| format | mutants | {' | '.join(OUTCOMES)} | CPU s | worst s | worst MB |", flush=True)
    print("|---|" + "---|" * (len(OUTCOMES) + 4), flush=True)
    failed, began = 0, time.monotonic()
    for name in names:
        counts, kinds, costs = Counter(), Counter(), []
        jobs = [(FORMATS[name], number) for number in range(told.first, told.first + told.mutants)]
        for one in tried(jobs, seeds, told.run):
            counts[one.outcome] += 1
            costs.append((one.seconds, one.megabytes))
            if one.outcome in FAILURES:
                kind = one.told.rpartition(" at ")[2] if one.outcome == "traceback" else one.told
                kinds[one.outcome, kind] += 1
                if kinds[one.outcome, kind] <= 3:
                    _keep(told, seeds[name], one)
        seconds, megabytes = zip(*costs, strict=True)
        row = [
            *(counts[one] for one in OUTCOMES),
            f"{sum(seconds):.0f}",
            f"{max(seconds):.2f}",
            f"{max(megabytes):.0f}",
        ]
        print(f"| {name} | {told.mutants} | {' | '.join(map(str, row))} |", flush=True)
        failed += sum(counts[one] for one in FAILURES)
    print(f"\n{told.mutants * len(names) / (time.monotonic() - began):.0f} mutants a second, {failed} failed")
    sys.exit(failed > 0)


def _keep(told: argparse.Namespace, seeds: dict[str, bytes], one: Tried) -> None:
    folder = told.failures / f"{one.form}-{told.run}-{one.number}"
    for file, data in mutant_of(FORMATS[one.form], seeds, told.run, one.number).items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    print(f"{one.outcome}: {one.form} --run {told.run} --first {one.number}: {one.told}", file=sys.stderr, flush=True)
