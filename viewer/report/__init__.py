"""Comparisons and their reports: ``compare`` runs one, ``page`` writes ``report.json`` and ``report.html``.

``entries`` and ``plots`` say what was found, ``pictures`` and ``video`` show it; ``baseline`` builds the single meshes.
"""
