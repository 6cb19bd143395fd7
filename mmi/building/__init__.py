"""From a city to a dataset, resumable at any moment, by several processes.

``dataset`` builds all cells, ``cell`` one; ``processes`` has the workers, ``halving`` cuts cells that exceed a budget.
"""
