"""The irregular z-buffer: hard shadows exactly at the eye's pixels (Aila and Laine 2004; Johnson et al. 2005).

A depth map samples the light's view where its texels happen to be. Here the receivers are the samples: every pixel is
projected into the light's view and sorted into the cells of a grid that is fitted to them, casters are drawn into all
cells that they touch, and each sample in such a cell is tested against the triangle itself. No depth is stored, nothing
is interpolated, and the size of the cells changes the cost but not the result.

- ``hidden``: begin here: the whole way from a G-buffer to visibility;
- ``grid``: light coordinates of points, and the grids of the light's faces;
- ``samples``: pixels to samples, sorted by cell; chunks of the image count for themselves, so that the order of the
  samples does not depend on the number of threads;
- ``casters``: the cells that a triangle touches, whether they hold a receiver, and the triangles of each band of rows;
- ``occlusion``: the exact test, one pixel at a time;
- ``pixel_lanes``, ``caster_lanes``, ``lanes``: projection, bounds and test on the CPU, many at a time. On the CPU each
  band is one thread's: it owns its rows' samples, and the pixels they came from. On CUDA each pixel goes through its
  band's triangles.
"""
