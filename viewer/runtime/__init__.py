"""The frame loop (``loop``), which draws one frame when asked, brings in what its plan needs, and times all of it."""
