"""What drives through a city: shapes of ``vehicles``, and ``traffic``: where each is at every tenth of a second."""
