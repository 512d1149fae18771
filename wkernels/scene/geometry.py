"""A scene's triangles on a device, rebased so that float32 keeps its precision anywhere in the world."""

from __future__ import annotations

import itertools

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.scene.model import Mesh, Scene

CASTS = wp.constant(1)
RECEIVES = wp.constant(2)
MOVES = wp.constant(4)


@wp.kernel
def find_normals(
    first: int,
    points_ws: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    normal_out: wp.array(dtype=wp.vec3),
):
    """Unit normal of each triangle, counter-clockwise side; zero where it has no area."""
    t = first + wp.tid()
    a = points_ws[indices[3 * t]]
    normal = wp.cross(points_ws[indices[3 * t + 1]] - a, points_ws[indices[3 * t + 2]] - a)
    longest = wp.max(wp.max(wp.abs(normal[0]), wp.abs(normal[1])), wp.abs(normal[2]))
    if longest > 0.0:
        normal = wp.normalize(normal / longest)  # scaled first: the squared length of tiny triangles underflows
    normal_out[t] = normal


class Bounds:
    """Axis-aligned boxes, float64, and the box around them all; ``empty`` before anything was added."""

    def __init__(self) -> None:
        self.low = np.full(3, np.inf)
        self.high = np.full(3, -np.inf)
        self._boxes: list[np.ndarray] = []

    def add(self, points: np.ndarray) -> None:
        """Adds the box of some points, shape (N, 3)."""
        if len(points):
            box = np.stack([points.min(axis=0), points.max(axis=0)])
            self._boxes.append(box)
            self.low = np.minimum(self.low, box[0])
            self.high = np.maximum(self.high, box[1])

    @property
    def empty(self) -> bool:
        return not self._boxes

    @property
    def corners(self) -> np.ndarray:
        """The eight corners of every box, shape (8 N, 3): a wide low box and a narrow high one leave the rest out."""
        pick = np.array(list(itertools.product((0, 1), repeat=3)))
        boxes = np.array(self._boxes).reshape(-1, 2, 3)
        return boxes[:, pick, np.arange(3)].reshape(-1, 3)


class Geometry:
    """All meshes of a scene in one set of arrays, casting meshes first, and of these the ones that stand still.

    World positions are stored minus ``origin_ws`` (float64, about the middle of the scene), so that world offsets of
    1e6 cost nothing; ``_ws`` on the device means this rebased world.

    Attributes:
        points_ws: vec3, shape (V,).
        indices: int32, shape (3 T,); the first ``3 * caster_triangles`` belong to casting meshes.
        triangle_normal_ws: vec3, shape (T,), unit.
        triangle_mesh: int32, shape (T,).
        caster_sets: int32 arrays like ``indices``: of casting meshes ``all``, the ``still`` or the ``moving`` ones.
        mesh_flags: int32, shape (M,): CASTS | RECEIVES | MOVES.
        mesh_diffuse: vec3, shape (M,).
        moving, casters_move: Whether any mesh moves, and whether any does that casts.
        moving_triangles: vec2i, one (begin, end) for each moving mesh.
        version: Grows whenever a vertex moves.
    """

    def __init__(self, scene: Scene, device: str = "cpu", threads: int | None = None) -> None:
        self.scene = scene
        self.device = device
        self.threads = threads
        self.meshes: list[Mesh] = sorted(scene.meshes, key=lambda mesh: (not mesh.casts, mesh.moving))
        self.version = 0
        self._frame: int | None = None
        self._poses: dict[int, np.ndarray] = {}  # of moving meshes; of those that change shape their vertices
        placed = [_place(mesh, 0) for mesh in self.meshes]
        box = Bounds()
        for vertices in placed:
            box.add(_finite(vertices))  # or one broken vertex would take the whole scene with it
        self.origin_ws = np.zeros(3) if box.empty else 0.5 * (box.low + box.high)
        placed = [vertices - self.origin_ws for vertices in placed]
        self._boxes = [_box(vertices) for vertices in placed]
        sizes = [len(mesh.faces) for mesh in self.meshes]
        starts = np.cumsum([0] + [len(mesh.vertices) for mesh in self.meshes])
        self._ranges = [slice(a, b) for a, b in itertools.pairwise(starts)]
        faces = [mesh.faces + start for mesh, start in zip(self.meshes, starts[:-1], strict=True)]
        flags = [CASTS * mesh.casts + RECEIVES * mesh.receives + MOVES * mesh.moving for mesh in self.meshes]
        diffuse = np.array([mesh.diffuse for mesh in self.meshes], dtype=np.float32).reshape(-1, 3)

        def upload(parts: list[np.ndarray], dtype: type, kind: str) -> wp.array:
            joined = np.concatenate(parts) if parts else np.zeros(0)
            return wp.array(np.ascontiguousarray(joined, dtype=kind), dtype=dtype, device=device)

        self.indices = upload([f.ravel() for f in faces], wp.int32, "int32")
        self.triangles = sum(sizes)
        self.caster_triangles = sum(n for n, mesh in zip(sizes, self.meshes, strict=True) if mesh.casts)
        self.still_triangles = sum(n for n, m in zip(sizes, self.meshes, strict=True) if m.casts and not m.moving)
        ends = np.cumsum([0, *sizes])
        moving = [(ends[i], ends[i + 1]) for i, mesh in enumerate(self.meshes) if mesh.moving]
        self.moving_triangles = wp.array(np.array(moving, np.int32).reshape(-1, 2), dtype=wp.vec2i, device=device)
        # Warp cannot slice an array of no elements, which a scene without meshes has
        self.caster_indices = self.indices[: 3 * self.caster_triangles] if self.triangles else self.indices
        still, end = 3 * self.still_triangles, 3 * self.caster_triangles
        self.caster_sets = {"all": self.caster_indices, "still": self.caster_indices, "moving": self.caster_indices}
        if self.triangles:
            # a slice must not begin at the end, not even an empty one
            moves = slice(still, end) if still < end else slice(0, 0)
            self.caster_sets |= {"still": self.indices[:still], "moving": self.indices[moves]}
        self.triangle_mesh = upload([np.repeat(np.arange(len(sizes)), sizes)], wp.int32, "int32")
        self.mesh_flags = wp.array(np.array(flags, dtype=np.int32), dtype=wp.int32, device=device)
        self.mesh_diffuse = wp.array(diffuse, dtype=wp.vec3, device=device)
        self.points_ws = upload([p.astype(np.float32).reshape(-1, 3) for p in placed], wp.vec3, "float32")
        self.triangle_normal_ws = wp.zeros(self.triangles, dtype=wp.vec3, device=device)
        self._update_normals()
        self.moving = any(mesh.moving for mesh in self.meshes)
        self.casters_move = any(mesh.moving and mesh.casts for mesh in self.meshes)
        self.set_frame(0)

    def set_frame(self, frame: int) -> None:
        """Moves the moving meshes to their poses at ``frame``."""
        if frame == self._frame:
            return
        first, self._frame = self._frame is None, frame
        moved = False
        for i, mesh in enumerate(self.meshes):
            if not mesh.moving:
                continue
            pose = mesh.object_to_ws(frame) if mesh.deformed is None else _place(mesh, frame)
            if i in self._poses and np.array_equal(pose, self._poses[i], equal_nan=True):
                continue  # a mover that pauses leaves every map as it was
            self._poses[i] = pose
            vertices = (pose if mesh.deformed is not None else _place(mesh, frame)) - self.origin_ws
            self._boxes[i] = _box(vertices)
            region = self._ranges[i]
            part = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
            wp.copy(self.points_ws, part, dest_offset=region.start, count=len(part))
            moved = True
        if moved and not first:
            self.version += 1
        if moved:
            self._update_normals()

    def boxes(self, *, moving: bool) -> np.ndarray:
        """Corners of the boxes of the casting meshes that move, or of those that do not, (n, 8, 3), rebased world."""
        chosen = [b for m, b in zip(self.meshes, self._boxes, strict=True) if m.casts and m.moving == moving]
        held = [box.corners for box in chosen if not box.empty]
        return np.array(held).reshape(-1, 8, 3)

    def bounds(self, *, casters: bool = False, receivers: bool = False, moving: bool | None = None) -> Bounds:
        """Box of the casting or receiving meshes (or both) at the current frame, rebased world.

        ``moving`` keeps those that move (True) or stand still (False); None both.
        """
        box = Bounds()
        for mesh, own in zip(self.meshes, self._boxes, strict=True):
            if moving is not None and mesh.moving != moving:
                continue
            if ((casters and mesh.casts) or (receivers and mesh.receives)) and not own.empty:
                box.add(np.stack([own.low, own.high]))
        return box

    def caster_buffers(self, *, moving: bool) -> tuple[wp.array, wp.array]:
        """The casting triangles of the meshes that move, or of those that stand still.

        Returns:
            Vertices, vec3 (V,), a view of ``points_ws`` that follows it, and int32 (3 T,) indices into them.
        """
        chosen = [i for i, mesh in enumerate(self.meshes) if mesh.casts and mesh.moving == moving and len(mesh.faces)]
        if not chosen:
            return self.points_ws, wp.empty(0, dtype=wp.int32, device=self.device)
        region = slice(int(self._ranges[chosen[0]].start), int(self._ranges[chosen[-1]].stop))
        faces = [self.meshes[i].faces + (self._ranges[i].start - region.start) for i in chosen]
        indices = np.ascontiguousarray(np.concatenate(faces).ravel(), dtype=np.int32)
        return self.points_ws[region], wp.array(indices, dtype=wp.int32, device=self.device)

    def _update_normals(self) -> None:
        launch(
            find_normals,
            self.triangles,
            [self.points_ws, self.indices],
            [self.triangle_normal_ws],
            device=self.device,
            threads=self.threads,
        )


def _box(vertices: np.ndarray) -> Bounds:
    box = Bounds()
    box.add(_finite(vertices))
    return box


def _finite(vertices: np.ndarray) -> np.ndarray:
    return vertices[np.isfinite(vertices).all(axis=1)]


def _place(mesh: Mesh, frame: int) -> np.ndarray:
    pose = mesh.object_to_ws(frame)
    with np.errstate(invalid="ignore"):  # vertices that are not finite stay so, and cast nothing
        placed: np.ndarray = np.asarray(mesh.vertices_at(frame), dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]
    return placed
