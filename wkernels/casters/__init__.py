"""Casters as shapes: their edges and silhouettes, the volumes behind them, flattened onto a plane, as blobs.

Begin with ``pulls``: ``edges`` says which faces meet where, ``silhouettes`` which edges bound what a light point sees,
and ``extrusion`` sweeps these into volumes. Meshes may be open, branch or be flipped; ``closed`` tells which are whole.
"""
