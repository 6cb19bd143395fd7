"""The cities that can be generated, by name, and the customs by which their quarters are built."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from citygen.buildings.development import Custom
from citygen.streets.subdivision import Ranks

__all__ = [
    "COTTAGES",
    "COUNTRY",
    "DOWNTOWN",
    "HILL_TOWN",
    "LANES",
    "MIDTOWN",
    "OLD_TOWN",
    "PARIS",
    "PRESETS",
    "ROWS",
    "SUBURB",
    "UPTOWN",
    "Preset",
]


@dataclass(frozen=True, slots=True)
class Preset:
    """A city that can be generated: its ``name``, one line about it, and the ``detail`` of its houses if none is asked for.

    ``detail`` None mixes details until the city has as many triangles as its model. Only a ``counted`` city takes a number
    of buildings.
    """

    name: str
    summary: str
    detail: int | None = 1
    counted: bool = False


PRESETS = MappingProxyType(
    {
        one.name: one
        for one in (
            Preset(
                "montmartre", "the hill of the 1999 paper: 146 blocks, 572 streets, 143,500 triangles, a church", None
            ),
            Preset("manhattan", "blocks of 80 x 270 m, avenues, a diagonal, towers that step back above podiums"),
            Preset("radial", "a European town: rings and radial streets around a church, courtyards"),
            Preset("hamlet", "a dozen houses on three blocks, for tutorials and tests"),
            Preset(
                "metropolis", "as many buildings as --buildings says, up to a million, downtown to suburbs", 0, True
            ),
            Preset("forest", "trees instead of houses"),
            Preset("living-room", "furniture instead of houses: a room and its walls"),
            Preset("pipes", "pipes instead of houses: racks of straight pieces, elbows and valves"),
            Preset("traffic", "the radial town with vehicles, whose ways go into a .traffic.json beside the city"),
        )
    }
)

PARIS = Custom(
    form="perimeter",
    lot=470.0,
    depth=12.0,
    storeys=(5.4, 0.9, 2, 8),
    styles=(("stucco", 5.0), ("stone", 4.0), ("brick", 1.0)),
    roofs=(("mansard", 6.0), ("gable", 3.0), ("hip", 1.0), ("flat", 1.0)),
    storey=3.2,
    chamfered=0.6,
)
HILL_TOWN = Custom(
    form="perimeter",
    lot=370.0,
    depth=11.0,
    storeys=(3.6, 0.9, 2, 6),
    styles=(("stucco", 7.0), ("stone", 2.0), ("brick", 1.0)),
    roofs=(("gable", 5.0), ("hip", 2.0), ("mansard", 2.0), ("flat", 1.0)),
    vacant=0.07,
    chamfered=0.2,
)
OLD_TOWN = Custom(
    form="perimeter",
    lot=210.0,
    depth=11.0,
    storeys=(3.8, 0.8, 2, 6),
    styles=(("stucco", 6.0), ("stone", 3.0), ("brick", 2.0)),
    roofs=(("gable", 7.0), ("hip", 2.0), ("mansard", 1.0)),
    vacant=0.02,
)
ROWS = Custom(
    form="perimeter",
    lot=240.0,
    depth=10.0,
    storeys=(2.6, 0.5, 2, 4),
    styles=(("brick", 6.0), ("stucco", 3.0)),
    roofs=(("gable", 7.0), ("flat", 2.0)),
    vacant=0.06,
)
SUBURB = Custom(
    form="detached",
    lot=520.0,
    depth=11.0,
    storeys=(1.7, 0.4, 1, 3),
    styles=(("stucco", 5.0), ("brick", 4.0)),
    roofs=(("gable", 6.0), ("hip", 4.0)),
    storey=2.9,
    vacant=0.04,
)
COTTAGES = Custom(
    form="detached",
    lot=950.0,
    depth=12.0,
    storeys=(1.6, 0.4, 1, 2),
    styles=(("stucco", 4.0), ("stone", 3.0), ("brick", 2.0)),
    roofs=(("gable", 7.0), ("hip", 3.0)),
    storey=2.9,
    vacant=0.0,
)
MIDTOWN = Custom(
    form="tower",
    lot=1150.0,
    depth=27.0,
    storeys=(10.0, 2.6, 4, 18),
    styles=(("glass", 4.0), ("stone", 4.0), ("brick", 3.0)),
    roofs=(("flat", 1.0),),
    storey=3.6,
    vacant=0.02,
    tall=0.42,
    tallest=75,
)
UPTOWN = Custom(
    form="tower",
    lot=640.0,
    depth=23.0,
    storeys=(6.5, 1.8, 3, 14),
    styles=(("brick", 6.0), ("stone", 3.0), ("glass", 1.0)),
    roofs=(("flat", 1.0),),
    storey=3.4,
    tall=0.13,
    tallest=42,
)
DOWNTOWN = MIDTOWN

COUNTRY = Ranks(
    kinds=("tertiary", "residential"),
    half_widths=(3.2, 2.6),
    shares=(0.4, 0.6),
    titles=("Road", "Lane"),
    names=("Mill", "Church", "Orchard", "Well", "Meadow", "Forge"),
    dead_end=("service", 2.0, "Yard"),
)
LANES = Ranks(
    kinds=("secondary", "tertiary", "residential", "living_street"),
    half_widths=(6.0, 4.5, 3.2, 2.6),
    shares=(0.06, 0.16, 0.5, 0.28),
    titles=("Boulevard", "Avenue", "Rue", "Passage"),
    names=(
        "des Abbesses", "du Moulin", "Lepic", "des Saules", "du Calvaire", "Gabrielle", "des Trois-Frères", "Tholozé",
        "de la Vigne", "Saint-Vincent", "du Mont-Cenis", "Cortot", "de l'Abreuvoir", "Norvins", "Durantin", "Houdon",
        "des Martyrs", "d'Orsel", "Caulaincourt", "Junot", "Lamarck", "Becquerel", "Utrillo", "Ravignan", "Berthe",
        "Androuet", "Garreau", "Véron", "Constance", "Tourlaque", "Damrémont", "Custine", "Ramey", "Muller", "Feutrier",
        "Nobel", "Paul-Albert", "Ronsard", "Cazotte", "Seveste",
    ),
    dead_end=("service", 2.2, "Impasse"),
)  # fmt: skip
