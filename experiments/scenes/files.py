"""Mesh files to triangles: which reader a file gets, and what holds for all of them."""

from __future__ import annotations

import warnings

import numpy as np

from experiments.scenes import schema
from experiments.scenes.assets import find_file
from experiments.scenes.meshes import collada_file, gltf, obj, off, ply, stl, usd
from experiments.scenes.meshes.reading import MeshError, Reader
from experiments.scenes.place import Place
from experiments.scenes.primitives import Triangles

READERS: dict[str, Reader] = {
    **{".obj": obj.read, ".ply": ply.read, ".stl": stl.read, ".off": off.read},
    **{".glb": gltf.read, ".gltf": gltf.read, ".dae": collada_file.read, ".zae": collada_file.read},
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), usd.read),
}
"""By suffix."""


class MeshWarning(UserWarning):
    """A mesh file is not drawn quite as it says: parts are left out, or turned."""


def read_triangles(name: str, place: Place) -> Triangles:
    """All triangles of a mesh file in the file's own coordinates, its scene graph applied.

    Vertices at exactly the same position become one (formats that split them for normals or texture coordinates would
    hide the adjacency that silhouettes need). Triangles that use a non-finite vertex are left out with a warning; those
    without area stay. What else a reader leaves out or turns is a MeshWarning too.

    Args:
        name: As in ``find_file``.
        place: Where the scene file names it.

    Returns:
        Vertices float64 (V, 3) and faces int32 (F, 3).

    Raises:
        InputError: The file is missing, unreadable, of an unknown format, needs a package that is not installed, uses
            vertices it does not have or coordinates beyond a scene's limits, or has no triangles with finite vertices.
    """
    path = find_file(name, place)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise place.error(f"'{path}' is of no known mesh format, which are {', '.join(READERS)}.")

    def tell(message: str) -> None:
        warnings.warn(MeshWarning(str(place.error(f"'{path}': {message}"))), stacklevel=3)

    try:
        vertices, faces = reader(path, tell)
    except MeshError as error:
        raise place.error(f"'{path}': {error}") from None
    except OSError as error:
        raise place.error(f"'{path}' cannot be read: {error.strerror or error}.") from None
    if not len(faces):
        raise place.error(f"'{path}' has no triangles.")
    finite = np.all(np.isfinite(vertices), axis=1)
    if not finite.any():
        raise place.error(f"'{path}' has no finite vertices.")
    good = np.all(finite[faces], axis=1)
    if not good.any():
        raise place.error(f"'{path}' has no triangle with finite vertices only.")
    if not good.all():
        tell(f"{np.count_nonzero(~good)} of {len(faces)} triangles have non-finite vertices and are left out.")
    vertices, faces = _weld(vertices, faces[good])
    furthest = float(np.abs(vertices).max())
    if furthest > schema.LARGEST:
        raise place.error(
            f"'{path}' has a coordinate of {furthest:.3g}; lengths beyond {schema.LARGEST:g} cannot be drawn."
        )
    return vertices, faces


def _weld(vertices: np.ndarray, faces: np.ndarray) -> Triangles:
    """Merges vertices that are equal to the last bit and drops unused ones; keeps the order of first use."""
    corners = faces.ravel()
    used, first, own = np.unique(corners, return_index=True, return_inverse=True)
    _, same = np.unique(vertices[used] + 0.0, axis=0, return_inverse=True)  # -0.0 equals 0.0
    first_use = np.full(same.max() + 1, len(corners))
    np.minimum.at(first_use, same.ravel(), first)
    order = np.argsort(first_use)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return vertices[corners[first_use[order]]] + 0.0, rank[same.ravel()[own]].reshape(-1, 3).astype(np.int32)
