"""Projections: where light depth maps look, composed of a fit, a warp, splits and a stabilisation.

Every technique that reads a light depth map does so through whatever composition its session was given.

- ``schema``: the keys of a projection, with units, ranges and defaults. Begin here;
- ``composition``: ``compose`` makes of them what a session is given;
- ``projection``: what the parts implement; ``table``: which there are;
- ``fits`` (what a light view covers), ``warps`` (how its texels are moved towards the eye), ``stabilisers`` (what keeps
  them still): one file each, and nothing else has to know of it. Partition schemes are formulas
  (``wkernels.projections.splits``).
"""
