"""The plan that a cell of a dataset was built from, made again: the dataset holds what it led to, not the plan.

It is held against the manifest, so that nobody is shown a plan that the dataset was not built from.
"""

from __future__ import annotations

from mmi.appearance.city_mesh import CityMesh
from mmi.city.model import City
from mmi.dataset.manifest import CellEntry
from mmi.dataset.reading import Dataset
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.planning.plan import CellPlan, PreparedCity, plan_cell, prepare_city, without_layers
from mmi.visibility.item_buffer import Identify

__all__ = ["planned_again", "prepared_again"]


def prepared_again(dataset: Dataset, city: City, *, mesh: CityMesh | None = None) -> PreparedCity:
    """The city of a dataset, prepared as its build did; ``mesh`` is its mesh where that is there already.

    This imports functions from outside the package that the manifest names, which runs their code. Raises DatasetError where
    they are others now, or anything else does not fit.
    """
    try:
        return prepare_city(city, dataset.manifest.parameters, mesh=mesh)
    except ParameterError as error:
        raise _rebuild(dataset, str(error)) from error


def planned_again(
    dataset: Dataset, prepared: PreparedCity, entry: CellEntry, *, identify: Identify | None = None
) -> CellPlan:
    """The plan that a cell with this ``entry`` of the manifest was built from; ``identify`` draws item buffers, where needed.

    Raises DatasetError where it is not the manifest's, ParameterError where ``identify`` is missing.
    """
    cell, near, far = entry.viewing_cell, list(entry.near), list(entry.far)
    stored = [(far[place], one.index) for _, one in entry.pictures for place in one.objects]
    plan = plan_cell(prepared, cell, identify=identify)
    names = [one.id for one in prepared.city.objects]
    if prepared.parameters.geometry == "cheaper":  # which layers cost more is known only once they are captured
        kept_near = set(near)
        plan = without_layers(plan, {k for k, layer in enumerate(plan.layers) if names[layer[0]] in kept_near})
    layer_of = {names[i]: index for index, members in enumerate(plan.layers) for i in members}
    for what, found, expected in (
        ("near objects", [names[i] for i in plan.selection.near], near),
        ("far objects", [names[i] for i in plan.selection.far], far),
        ("layers", [layer_of.get(name) for name, _ in stored], [index for _, index in stored]),
    ):
        if found != expected:
            raise _rebuild(dataset, f"the {what} of cell {cell.id} are not those that this version finds")
    return plan


def _rebuild(dataset: Dataset, what: str) -> DatasetError:
    return DatasetError(f"{dataset.path / 'manifest.json'}: {what}; run build-impostors again")
