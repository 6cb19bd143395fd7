"""The frame loop (``loop``): one frame when asked; what its plan needs is brought in, it is drawn, and all of it is timed."""
