"""What moves through a city: shapes and where each is over time, as one value (``movers``) that files hold (``movers_file``).

Cities know nothing of it: vehicles, boats or people come from ``citygen traffic``, or from any JSON of the same schema.
"""
