"""What reading a city found, mended, guessed and left out: the account that keeps anything from being dropped silently.

Readers write into a ``Ledger``; ``CityReport`` is the frozen result. Everything that was read is either in the city
(``kept``) or counted under ``left out`` with a reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

__all__ = ["CityReport", "Ledger", "Section", "Tally"]

Section = Literal["read", "kept", "repaired", "inferred", "noted", "left out"]

_EXAMPLES = 3
"""Ids kept per line as examples."""
_REASONS = 4
"""Reasons named in a refusal."""


@dataclass(frozen=True, slots=True)
class Tally:
    """One line of the account: ``what`` happened ``count`` times, for instance to ``examples``, to ``metres`` of street."""

    what: str
    count: int
    examples: tuple[str, ...] = ()
    metres: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; no ``metres`` where none were measured."""
        row: dict[str, Any] = {"what": self.what, "count": self.count, "examples": list(self.examples)}
        return row if self.metres is None else row | {"metres": round(self.metres, 1)}


@dataclass(frozen=True, slots=True)
class CityReport:
    """The account of one reading.

    ``read``: what the files held. ``kept``: what became of it. ``repaired``: what was mended on the way. ``inferred``:
    where heights come from. ``noted``: seen and left as it is. ``left_out``: category and reason. ``crs`` and ``origin``
    are the city's; ``warnings`` are sentences worth printing.
    """

    source: str
    crs: str
    origin: tuple[float, float, float]
    read: tuple[Tally, ...]
    kept: tuple[Tally, ...]
    repaired: tuple[Tally, ...]
    inferred: tuple[Tally, ...]
    noted: tuple[Tally, ...]
    left_out: tuple[Tally, ...]
    warnings: tuple[str, ...]

    def sections(self) -> dict[Section, tuple[Tally, ...]]:
        """The lines of the account under their headings, in printing order."""
        return {
            "read": self.read,
            "kept": self.kept,
            "repaired": self.repaired,
            "inferred": self.inferred,
            "noted": self.noted,
            "left out": self.left_out,
        }

    def rows(self) -> list[tuple[str, str, str, str]]:
        """A short table: (section, what, count, metres and example ids); warnings come last with an empty count."""
        rows: list[tuple[str, str, str, str]] = []
        for section, tallies in self.sections().items():
            for one in tallies:
                detail = [] if one.metres is None else [f"{one.metres:.0f} m"]
                if one.examples:
                    more = ", ..." if one.count > len(one.examples) else ""
                    detail.append(", ".join(one.examples) + more)
                rows.append((section, one.what, str(one.count), "; ".join(detail)))
        return rows + [("warning", text, "", "") for text in self.warnings]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, in a fixed order."""
        head: dict[str, Any] = {"source": self.source, "crs": self.crs, "origin": list(self.origin)}
        for section, tallies in self.sections().items():
            head[section.replace(" ", "_")] = [one.as_dict() for one in tallies]
        return head | {"warnings": list(self.warnings)}


@dataclass(slots=True)
class Ledger:
    """Collects tallies while a city is read; lines keep the order in which they were first written."""

    _lines: dict[tuple[Section, str], tuple[int, tuple[str, ...], float | None]] = field(default_factory=dict)
    _warnings: list[str] = field(default_factory=list)

    def note(
        self, section: Section, what: str, example: str | None = None, *, count: int = 1, metres: float | None = None
    ) -> None:
        """Add ``count`` (nothing if 0) and ``metres`` to the line ``what``, with an example id."""
        if count == 0:
            return
        total, examples, length = self._lines.get((section, what), (0, (), None))
        if example is not None and len(examples) < _EXAMPLES and example not in examples:
            examples = (*examples, example)
        if metres is not None:
            length = metres + (length or 0.0)
        self._lines[section, what] = (total + count, examples, length)

    def warn(self, text: str) -> None:
        """Add a sentence that the user should see, once."""
        if text not in self._warnings:
            self._warnings.append(text)

    def absorb(self, other: Ledger) -> None:
        """Add everything that ``other`` has."""
        for line, (more, ids, length) in other._lines.items():
            total, examples, metres = self._lines.get(line, (0, (), None))
            both = tuple(dict.fromkeys((*examples, *ids)))[:_EXAMPLES]
            self._lines[line] = (total + more, both, metres if length is None else length + (metres or 0.0))
        for text in other._warnings:
            self.warn(text)

    def count(self, section: Section, what: str | None = None) -> int:
        """Total of the line ``what``, or of the whole section."""
        return sum(n for (s, w), (n, _, _) in self._lines.items() if s == section and what in (None, w))

    def count_of_kind(self, section: Section, kind: str) -> int:
        """Total of the lines whose ``kind`` of object stands before their colon."""
        return sum(n for (s, what), (n, _, _) in self._lines.items() if s == section and what.startswith(f"{kind}: "))

    def why_left_out(self, kind: str = "") -> str:
        """``"; left out: 8 outline not closed, 2 underground"``: the counted reasons of a ``kind`` of object, most first.

        Empty where nothing of it was left out. ``kind`` is what stands before the colon (``building``), empty for all.
        """
        lines = [(what, n) for (section, what), (n, _, _) in self._lines.items() if section == "left out"]
        reasons = [(what.removeprefix(f"{kind}: "), n) for what, n in lines if not kind or what.startswith(f"{kind}: ")]
        reasons.sort(key=lambda reason: -reason[1])
        more = sum(n for _, n in reasons[_REASONS:])
        told = [f"{n} {what}" for what, n in reasons[:_REASONS]] + ([f"{more} for other reasons"] if more else [])
        return f"; left out: {', '.join(told)}" if told else ""

    def report(self, *, source: str, crs: str, origin: tuple[float, float, float]) -> CityReport:
        """The frozen account."""

        def lines(wanted: Section) -> tuple[Tally, ...]:
            return tuple(Tally(w, n, ids, m) for (s, w), (n, ids, m) in self._lines.items() if s == wanted)

        return CityReport(
            source=source,
            crs=crs,
            origin=origin,
            read=lines("read"),
            kept=lines("kept"),
            repaired=lines("repaired"),
            inferred=lines("inferred"),
            noted=lines("noted"),
            left_out=lines("left out"),
            warnings=tuple(self._warnings),
        )
