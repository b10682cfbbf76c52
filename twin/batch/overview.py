"""What the results of all axes say of the fleet: each parameter's spread, who stands apart, what is missing where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twin.batch.axis_run import AxisResult
from twin.diagnosis.change import NOT_COMPARED
from twin.display.numbers import listed, number, percent
from twin.display.table import DisplayTable, Tabular
from twin.effects.catalogue import EFFECTS
from twin.estimation.population import Population, population_of

#: Probability that any axis is named for any parameter in a fleet in which none stands apart.
FALSE_ALARMS = 0.05
#: Axes that a sentence names one by one.
MOST_NAMED = 6


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Tabular):
    """Many axes of one kind.

    Attributes
    ----------
    results : tuple of AxisResult
        One for each axis, in the order of the list.
    populations : mapping
        Of each parameter that several axes fix, by its name.
    """

    results: tuple[AxisResult, ...]
    populations: Mapping[str, Population]

    @property
    def failed(self) -> tuple[AxisResult, ...]:
        return tuple(r for r in self.results if r.failed)

    @property
    def outliers(self) -> dict[str, tuple[str, ...]]:
        """By axis: the parameters in which it stands apart."""
        found: dict[str, list[str]] = {}
        for name, p in self.populations.items():
            for axis in p.outliers:
                found.setdefault(axis, []).append(name)
        return {axis: tuple(names) for axis, names in found.items()}

    @property
    def missing(self) -> dict[str, tuple[str, ...]]:
        """By effect, the most frequent first: the axes whose first model left it out."""
        count = Counter(e for r in self.results for e in r.effects)
        return {e: tuple(r.axis for r in self.results if e in r.effects) for e, _ in count.most_common()}

    def unit(self, parameter: str) -> str:
        return next(r.units[parameter] for r in self.results if parameter in r.units)

    def table(self) -> DisplayTable:
        """One row for each axis."""
        apart = self.outliers
        rows = [
            (r.axis, r.verdict.replace("_", " "), ", ".join(r.effects), ", ".join(apart.get(r.axis, ())))
            for r in self.results
        ]
        columns = ("axis", "verdict", "left out", "stands apart in")
        return DisplayTable(f"fleet of {len(self.results)} axes", columns, rows, sentences(self))


def overview(results: Sequence[AxisResult]) -> Fleet:
    """The fleet that these results make. A parameter is compared among the axes whose recordings fix it."""
    done = [r for r in results if not r.failed]
    names = list(dict.fromkeys(n for r in done for n in r.stds if n not in NOT_COMPARED))
    fixing = {n: [r for r in done if r.stds.get(n, 0.0) > 0.0 and n not in r.undetermined] for n in names}
    compared = {n: found for n, found in fixing.items() if len(found) > 1}
    populations = {
        n: population_of(
            {r.axis: r.values[n] for r in found}, {r.axis: r.stds[n] for r in found}, FALSE_ALARMS / len(compared),
            angle=found[0].units[n] == "rad",
        )
        for n, found in compared.items()
    }  # fmt: skip
    return Fleet(tuple(results), populations)


def named(axes: Sequence[str]) -> str:
    """Axes by name, or how many they are."""
    return listed(axes) if len(axes) <= MOST_NAMED else f"{len(axes)} axes"


def spread_text(population: Population, unit: str) -> str:
    """How far the axes differ from one another."""
    if population.by_ratio:
        return percent(population.spread) if population.spread > 0.0 else "nothing beyond the errors"
    return f"{number(population.spread, 2)} {unit}" if population.spread > 0.0 else "nothing beyond the errors"


def sentences(fleet: Fleet) -> list[str]:
    """What a person has to know of the fleet."""
    done = len(fleet.results) - len(fleet.failed)
    said = [f"{done} of {len(fleet.results)} axes have their twin."]
    for effect, axes in fleet.missing.items():
        said.append(f"The first model left out {EFFECTS[effect].title}: {named(axes)}.")
    for axis, names in fleet.outliers.items():
        told = []
        for n in names:
            p, shown = fleet.populations[n], fleet.unit(n)
            value = p.values[p.axes.index(axis)]
            unit = "" if shown == "1" else f" {shown}"
            told.append(f"{n.replace('_', ' ')} {number(value)}{unit}, where the others have {number(p.centre)}")
        said.append(f"Axis {axis} stands apart: {'; '.join(told)}.")
    said += [f"Axis {r.axis} failed: {r.says}" for r in fleet.failed]
    return said


def to_json(fleet: Fleet) -> dict[str, Any]:
    """The fleet for programs."""
    return {
        "format": "twin-fleet/1",
        "axes": [
            {
                "axis": r.axis, "verdict": r.verdict, "says": r.says, "effects": list(r.effects),
                "undetermined": list(r.undetermined),
                "parameters": {
                    n: {"value": v, "std": r.stds.get(n), "unit": r.units[n]} for n, v in r.values.items()
                },
                "stands_apart_in": list(fleet.outliers.get(r.axis, ())), "seconds": r.seconds,
            }
            for r in fleet.results
        ],
        "parameters": {
            n: {
                "centre": p.centre, "spread": p.spread,
                "spread_is": "of the logarithm" if p.by_ratio else fleet.unit(n),
                "axes": list(p.axes), "outliers": list(p.outliers),
            }
            for n, p in fleet.populations.items()
        },
        "missing_effects": {e: list(axes) for e, axes in fleet.missing.items()},
        "says": sentences(fleet),
    }  # fmt: skip


def columns(fleet: Fleet) -> dict[str, list[str] | list[float]]:
    """The fleet as a table, one row for each axis: what it is, and every parameter with its standard error."""
    apart = fleet.outliers
    names = list(dict.fromkeys(n for r in fleet.results for n in r.values))
    table: dict[str, list[str] | list[float]] = {
        "axis": [r.axis for r in fleet.results],
        "verdict": [r.verdict for r in fleet.results],
        "effects": [" ".join(r.effects) for r in fleet.results],
        "stands_apart_in": [" ".join(apart.get(r.axis, ())) for r in fleet.results],
        "says": [r.says for r in fleet.results],
    }
    for n in names:
        table[n] = [r.values.get(n, float("nan")) for r in fleet.results]
        table[f"{n}_std"] = [r.stds.get(n, float("nan")) for r in fleet.results]
    return table
