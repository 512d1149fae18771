"""Mesh files to triangles, a file per format; what is dropped or turned on the way is told, what is broken is refused.

Every reader is ``read(path, tell)`` and gives all triangles in the file's own coordinates, its scene graph applied.
Begin with ``reading``, which says what a reader may raise and tell; ``polygons`` splits faces of many corners,
``gltf_document`` and ``usd_prims`` hold what the import of whole scenes needs too.
"""
