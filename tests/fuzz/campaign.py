"""Mutants of many formats, two processes at a time: the table, and the folder of those that failed."""

from __future__ import annotations

import argparse
import resource
import sys
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
    print(f"| format | mutants | {' | '.join(OUTCOMES)} | CPU s |", flush=True)
    print("|---|" + "---|" * (len(OUTCOMES) + 2), flush=True)
    failed = 0
    for name in names:
        form, start = FORMATS[name], _processor_time()
        counts, kinds = Counter(), Counter()
        for one in tried(form, seeds[name], told.run, range(told.first, told.first + told.mutants)):
            counts[one.outcome] += 1
            if one.outcome in FAILURES:
                kind = one.told.rpartition(" at ")[2] if one.outcome == "traceback" else one.told
                kinds[one.outcome, kind] += 1
                if kinds[one.outcome, kind] <= 3:
                    _keep(told, name, seeds[name], one)
        row = " | ".join(str(counts[one]) for one in OUTCOMES)
        print(f"| {name} | {told.mutants} | {row} | {_processor_time() - start:.0f} |", flush=True)
        failed += sum(counts[one] for one in FAILURES)
    sys.exit(failed > 0)


def _processor_time() -> float:
    """Seconds that the children which have ended took."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _keep(told: argparse.Namespace, name: str, seeds: dict[str, bytes], one: Tried) -> None:
    folder = told.failures / f"{name}-{told.run}-{one.number}"
    for file, data in mutant_of(FORMATS[name], seeds, told.run, one.number).items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    print(f"{one.outcome}: {name} --run {told.run} --first {one.number}: {one.told}", file=sys.stderr, flush=True)
