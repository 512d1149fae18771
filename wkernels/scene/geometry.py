"""A scene's triangles on a device, rebased so that float32 keeps its precision anywhere in the world."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Hashable
from typing import NamedTuple

import numpy as np
import warp as wp

from wkernels.device.launch import launch
from wkernels.errors import InputError
from wkernels.scene.cutouts import Cutouts, cutouts_of, upload_cutouts
from wkernels.scene.model import Mesh, Scene
from wkernels.scene.origin import PRECISION, eye_box, origin_of
from wkernels.scene.rest import Poses

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
            self.add_boxes(np.stack([points.min(axis=0), points.max(axis=0)])[None])

    def add_boxes(self, boxes: np.ndarray) -> None:
        """Adds boxes by their low and high corners, shape (N, 2, 3)."""
        if len(boxes):
            self._boxes.append(boxes)
            self.low = np.minimum(self.low, boxes[:, 0].min(axis=0))
            self.high = np.maximum(self.high, boxes[:, 1].max(axis=0))

    @property
    def empty(self) -> bool:
        return not self._boxes

    @property
    def corners(self) -> np.ndarray:
        """The eight corners of every box, shape (8 N, 3): a wide low box and a narrow high one leave the rest out."""
        pick = np.array(list(itertools.product((0, 1), repeat=3)))
        boxes = np.concatenate([*self._boxes, np.zeros((0, 2, 3))])
        return boxes[:, pick, np.arange(3)].reshape(-1, 3)


class CasterBuffers(NamedTuple):
    """Some of the casting triangles by themselves.

    Attributes:
        points_ws: vec3 (V,), a view of ``Geometry.points_ws`` that follows it.
        indices: int32 (3 T,), into them.
        cutouts: Of them.
    """

    points_ws: wp.array
    indices: wp.array
    cutouts: Cutouts


class Geometry:
    """All meshes of a scene in one set of arrays, casting meshes first, and of these the ones that never move.

    World positions are stored minus ``origin_ws`` (float64, ``scene.origin``: the middle of what is around the eye), so
    that world offsets of 1e6 cost nothing; ``_ws`` on the device means this rebased world.

    A mesh that may move but rests (``scene.rest``) counts as one that stands still, until it moves again.

    Attributes:
        points_ws: vec3, shape (V,).
        indices: int32, shape (3 T,); the first ``3 * caster_triangles`` belong to casting meshes.
        triangle_normal_ws: vec3, shape (T,), unit.
        triangle_mesh: int32, shape (T,).
        caster_sets: int32 arrays like ``indices``: of casting meshes ``all``, the ``still`` or the ``moving`` ones.
        cutouts: Where triangles are not there, by their vertices.
        mesh_flags: int32, shape (M,): CASTS | RECEIVES | MOVES.
        mesh_diffuse: vec3, shape (M,).
        moving: Whether any mesh may move.
        casters_move: Whether any mesh moves that casts.
        moving_triangles: vec2i, one (begin, end) for each mesh that moves.
        movable_triangles: (begin, end) for each mesh that may move.
        resting: Indices of the meshes that may move but rest.
        still_triangles: How many casting triangles stand still.
        version: Grows whenever a vertex moves, or a mesh comes to rest or leaves it.
    """

    def __init__(self, scene: Scene, device: str = "cpu", threads: int | None = None) -> None:
        self.scene = scene
        self.device = device
        self.threads = threads
        self.meshes: list[Mesh] = sorted(scene.meshes, key=lambda mesh: (not mesh.casts, mesh.moving))
        self.cutouts = upload_cutouts(self.meshes, device)
        self.version = 0
        self._frame: int | None = None
        self._shown: dict[int, np.ndarray] = {}
        self.poses = Poses({i: _state(mesh) for i, mesh in enumerate(self.meshes) if mesh.moving})
        placed = [placed_vertices(mesh, 0) for mesh in self.meshes]
        self._eyes = eye_box(scene)
        held = [box for vertices in placed if (box := box_of(vertices)) is not None]
        self.origin_ws = origin_of(np.array(held).reshape(-1, 2, 3), self._eyes)
        placed = [vertices - self.origin_ws for vertices in placed]
        self._casts, self._receives = (
            np.array([getattr(mesh, what) for mesh in self.meshes], bool) for what in ("casts", "receives")
        )
        self._boxes = np.full((len(placed), 2, 3), np.nan)  # NaN where a mesh has no finite vertex
        for i, vertices in enumerate(placed):
            self._box(i, vertices)
        self._noticed = self._find_noticed()
        sizes = [len(mesh.faces) for mesh in self.meshes]
        starts = np.cumsum([0] + [len(mesh.vertices) for mesh in self.meshes])
        self._ranges = [slice(a, b) for a, b in itertools.pairwise(starts)]
        self._ends = np.cumsum([0, *sizes])
        faces = [mesh.faces + start for mesh, start in zip(self.meshes, starts[:-1], strict=True)]
        diffuse = np.array([mesh.diffuse for mesh in self.meshes], dtype=np.float32).reshape(-1, 3)

        def upload(parts: list[np.ndarray], dtype: type, kind: str) -> wp.array:
            joined = np.concatenate(parts) if parts else np.zeros(0)
            return wp.array(np.ascontiguousarray(joined, dtype=kind), dtype=dtype, device=device)

        self.indices = upload([f.ravel() for f in faces], wp.int32, "int32")
        self.triangles = sum(sizes)
        self.caster_triangles = sum(n for n, mesh in zip(sizes, self.meshes, strict=True) if mesh.casts)
        self.movable_triangles = [self._range_of(i) for i, mesh in enumerate(self.meshes) if mesh.moving]
        # Warp cannot slice an array of no elements, which a scene without meshes has
        self.caster_indices = self.indices[: 3 * self.caster_triangles] if self.triangles else self.indices
        self.triangle_mesh = upload([np.repeat(np.arange(len(sizes)), sizes)], wp.int32, "int32")
        self.mesh_diffuse = wp.array(diffuse, dtype=wp.vec3, device=device)
        self.points_ws = upload([p.astype(np.float32).reshape(-1, 3) for p in placed], wp.vec3, "float32")
        self.triangle_normal_ws = wp.zeros(self.triangles, dtype=wp.vec3, device=device)
        self._update_normals()
        self.moving = any(mesh.moving for mesh in self.meshes)
        self.resting: frozenset[int] = frozenset()
        self._sort_out()
        self.set_frame(0)

    def set_frame(self, frame: int) -> None:
        """Moves the meshes that move to their poses at ``frame``."""
        if frame == self._frame:
            return
        first, self._frame = self._frame is None, frame
        moved = False
        for i, mesh in enumerate(self.meshes):
            if not mesh.moving:
                continue
            pose = self.poses.at(i, frame)
            if i in self._shown and np.array_equal(pose, self._shown[i]):
                continue  # a mover that pauses leaves every map as it was
            self._shown[i] = pose
            vertices = placed_vertices(mesh, frame) - self.origin_ws
            self._box(i, vertices)
            region = self._ranges[i]
            part = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
            wp.copy(self.points_ws, part, dest_offset=region.start, count=len(part))
            moved = True
        if moved:
            self._update_normals()
            self._noticed = self._find_noticed()
        resting = self.poses.resting(frame)
        changed = resting != self.resting
        if changed:
            self.resting = resting
            self._sort_out()
        if (moved or changed) and not first:
            self.version += 1

    @property
    def resting_at(self) -> Hashable:
        """Which casters rest, and where; comparable."""
        return tuple((i, self._shown[i].tobytes()) for i in sorted(self.resting) if self.meshes[i].casts)

    def moves(self, mesh: int) -> bool:
        """Whether a mesh, by its index, moves at the current frame."""
        return self.meshes[mesh].moving and mesh not in self.resting

    def _range_of(self, mesh: int) -> tuple[int, int]:
        return int(self._ends[mesh]), int(self._ends[mesh + 1])

    def _sort_out(self) -> None:
        """What follows from which meshes move: flags, ranges and sets of casters."""
        numbered = list(enumerate(self.meshes))
        self._moves = np.array([self.moves(i) for i, _ in numbered], bool)
        flags = [CASTS * mesh.casts + RECEIVES * mesh.receives + MOVES * self.moves(i) for i, mesh in numbered]
        self.mesh_flags = wp.array(np.array(flags, dtype=np.int32), dtype=wp.int32, device=self.device)
        ranges = [self._range_of(i) for i, _ in numbered if self.moves(i)]
        self.moving_triangles = wp.array(np.array(ranges, np.int32).reshape(-1, 2), dtype=wp.vec2i, device=self.device)
        self.casters_move = any(self.moves(i) and mesh.casts for i, mesh in numbered)
        self.caster_sets = {"all": self.caster_indices, "still": self.caster_indices, "moving": self.caster_indices}
        self.still_triangles = 0
        if not self.triangles:
            return
        still = sum(end - begin for begin, end in (self._range_of(i) for i, m in numbered if m.casts and not m.moving))
        kept = [self._range_of(i) for i, mesh in numbered if mesh.casts and mesh.moving and not self.moves(i)]
        # a slice must not begin at the end, not even an empty one
        moves = slice(3 * still, 3 * self.caster_triangles) if still < self.caster_triangles else slice(0, 0)
        self.caster_sets |= {"still": self.indices[: 3 * still], "moving": self.indices[moves]}
        if kept:
            of_casters = self.caster_indices.numpy().reshape(-1, 3)
            rests = np.zeros(len(of_casters), bool)
            for begin, end in kept:
                rests[begin:end] = True
            rests[:still] = True
            for name, chosen in (("still", rests), ("moving", ~rests)):
                picked = np.ascontiguousarray(of_casters[chosen].ravel())
                self.caster_sets[name] = wp.array(picked, dtype=wp.int32, device=self.device)
        self.still_triangles = len(self.caster_sets["still"]) // 3

    def _box(self, mesh: int, vertices: np.ndarray) -> None:
        box = box_of(vertices)
        self._boxes[mesh] = np.nan if box is None else box

    @property
    def _has_box(self) -> np.ndarray:
        return ~np.isnan(self._boxes[:, 0, 0])

    def _find_noticed(self) -> np.ndarray:
        """Which meshes are around the eye or large enough to be seen, bool (M,); of those that have a box."""
        out = self._has_box
        if out.any():
            out[out] = self._eyes.noticed(self._boxes[out] + self.origin_ws)
        return out

    def boxes(self, *, moving: bool) -> np.ndarray:
        """Corners of the boxes of the casting meshes that move, or of those that do not, (n, 8, 3), rebased world."""
        return self.bounds(casters=True, moving=moving).corners.reshape(-1, 8, 3)

    @property
    def mesh_boxes(self) -> np.ndarray:
        """Low and high corner of each mesh that has a finite vertex, float64 (n, 2, 3), rebased world."""
        return self._boxes[self._has_box]

    def box(self, mesh: int, frame: int) -> np.ndarray | None:
        """Low and high corner (2, 3) of a mesh at any frame, rebased world; None where it has no finite vertex."""
        return box_of(placed_vertices(self.meshes[mesh], frame) - self.origin_ws)

    def bounds(
        self, *, casters: bool = False, receivers: bool = False, moving: bool | None = None, noticed: bool = False
    ) -> Bounds:
        """Box of the casting or receiving meshes (or both) at the current frame, rebased world.

        Args:
            casters, receivers: Which.
            moving: Those that move (True) or stand still (False); None both.
            noticed: Only those that are around the eye or large enough to be seen from it.
        """
        chosen = self._has_box & ((casters & self._casts) | (receivers & self._receives))
        if moving is not None:
            chosen &= self._moves == moving
        if noticed:
            chosen &= self._noticed
        out = Bounds()
        out.add_boxes(self._boxes[chosen])
        return out

    @property
    def span(self) -> float:
        """The size of what is around the eye, scene units: what is relative to the scene's size is relative to this.

        The diagonal of what is noticed, but no more than leaves float32 what is seen from near by.
        """
        box = self.bounds(casters=True, receivers=True, noticed=True)
        if box.empty:
            return 0.0
        sight = self._eyes.sight(box.low + self.origin_ws, box.high + self.origin_ws)
        return min(float(np.linalg.norm(box.high - box.low)), 2.0 * PRECISION * sight)

    def caster_buffers(self, *, moving: bool) -> CasterBuffers:
        """The casting triangles of the meshes that move, or of those that stand still."""
        chosen = [i for i, mesh in enumerate(self.meshes) if mesh.casts and self.moves(i) == moving and len(mesh.faces)]
        if not chosen:
            return CasterBuffers(self.points_ws, wp.empty(0, dtype=wp.int32, device=self.device), self.cutouts)
        region = slice(int(self._ranges[chosen[0]].start), int(self._ranges[chosen[-1]].stop))
        faces = [self.meshes[i].faces + (self._ranges[i].start - region.start) for i in chosen]
        indices = np.ascontiguousarray(np.concatenate(faces).ravel(), dtype=np.int32)
        on_device = wp.array(indices, dtype=wp.int32, device=self.device)
        return CasterBuffers(self.points_ws[region], on_device, cutouts_of(self.cutouts, region))

    def require_whole(self, what: str) -> None:
        """Raises InputError where a caster is cut out by a texture, and so has no outline that its triangles know.

        Args:
            what: Who asks, as the sentence's subject, such as ``silhouettes``.
        """
        if (cut := self.scene.cut_caster) is not None:
            raise InputError(f"{what} need whole casters; the mesh '{cut.name}' is cut out by a texture.")

    def _update_normals(self) -> None:
        launch(
            find_normals,
            self.triangles,
            [self.points_ws, self.indices],
            [self.triangle_normal_ws],
            device=self.device,
            threads=self.threads,
        )


def box_of(vertices: np.ndarray) -> np.ndarray | None:
    """Low and high corner (2, 3) of vertices (V, 3), of those that are finite; None where none is."""
    held = vertices[np.isfinite(vertices).all(axis=1)]  # or one broken vertex would take the whole scene with it
    return np.stack([held.min(axis=0), held.max(axis=0)]) if len(held) else None


def placed_vertices(mesh: Mesh, frame: int) -> np.ndarray:
    """A mesh's vertices at a frame, world space, float64 (V, 3)."""
    pose = mesh.object_to_ws(frame)
    with np.errstate(invalid="ignore"):  # vertices that are not finite stay so, and cast nothing
        placed: np.ndarray = np.asarray(mesh.vertices_at(frame), dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]
    return placed


def _state(mesh: Mesh) -> Callable[[int], np.ndarray]:
    """What is the same at two frames where the mesh is: its pose; where it changes shape a digest of its vertices."""

    def digest(frame: int) -> np.ndarray:
        return np.frombuffer(hashlib.sha256(placed_vertices(mesh, frame).tobytes()).digest(), np.uint8)

    return mesh.object_to_ws if mesh.deformed is None else digest
