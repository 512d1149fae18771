"""Meshes, lights and cameras, as the host and the kernels see them.

Begin with ``model``, the scene; ``geometry`` is its triangles on the device, ``views`` where eyes and lights look.
"""
