"""From a city to a dataset, resumable at any moment, by several processes.

``dataset`` builds all cells, ``cell`` one; ``workers`` are the processes, ``halving`` cuts cells that exceed a budget.
"""
