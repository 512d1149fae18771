"""Whether a caster encloses a volume."""

from __future__ import annotations

from wkernels.casters.edges import find_edges
from wkernels.scene.model import Mesh


def is_closed(mesh: Mesh) -> bool:
    """Whether the mesh is a closed, consistently oriented 2-manifold once vertices at the same position are merged.

    One that is cut out by a texture is none: its surface ends within its triangles.
    """
    return mesh.mask is None and find_edges(mesh.vertices, mesh.faces).is_closed
