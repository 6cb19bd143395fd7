"""What is near, what is far, and which far objects share a layer: decides, and draws nothing.

``plan`` tells it top to bottom; ``parameters`` are what a user sets, ``choices`` the tables of what can be chosen by name.
``segmentation`` divides near from far, ``weighing`` weighs pairs of far objects, ``layering`` colours the graph of visibility
events, ``rehearsal`` looks at the plan from around the cell and makes near what it misses, ``mesh_rehearsal`` does so where
there are more than prisms.
"""
