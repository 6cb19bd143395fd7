"""From a city to a dataset, resumable at any moment, by several processes.

``cell_choice`` says which cells are built, ``dataset`` builds them, ``cell`` one of them; ``workers`` are the processes,
``halving`` cuts cells that exceed a budget.
"""
