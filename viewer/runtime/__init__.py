"""The frame loop (``loop``): plans are made, what they need is brought in, they are drawn, and all of it is timed."""
