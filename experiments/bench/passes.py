"""Single passes beside the peer's: depth maps, a G-buffer, the pixel pass of ``pcss``; and two threads beside one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import warp as wp

from algorithms.plugins import find
from experiments.bench.llvmpipe import Llvmpipe
from experiments.bench.meshes import camera, spheres_on_terrain, sun, sunlit_scene
from experiments.bench.plan import Bench
from experiments.bench.rows import Row, Timed, interleaved_medians
from wkernels.filters.penumbra import pull_footprint, tap_set
from wkernels.frame.session import Session
from wkernels.light_maps.light_map import BORDER, ROUNDING, depths_on_host
from wkernels.projections.light_views import scene_views
from wkernels.raster import CULL_BACK, Rasteriser
from wkernels.raster.gbuffer import GBuffer
from wkernels.scene.geometry import CASTS, RECEIVES, Bounds, Geometry
from wkernels.scene.views import HostView, eye_view

SUN_DEG = 6.0  # angular diameter of the soft sun; with large spheres many pixels search and filter
SOFT_CAMERA_HEIGHT = 120.0  # above them
DEPTH_TOLERANCE = 1e-3  # share of the depth range; both snap corners to 1/256 pixel, which shows on steep faces
TAP_TOLERANCE = 0.5 / 16.0  # less than one of the 16 taps


class OurTriangles:
    """Our pass of the same triangles: depth, and the triangle of each pixel if wanted."""

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, view: HostView, with_triangles: bool, threads: int
    ) -> None:
        shape = (view.height, view.width)
        self._rasteriser = Rasteriser("cpu", threads)
        self._points = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device="cpu")
        self._indices = wp.array(faces.ravel(), dtype=int, device="cpu")
        self._view = view.to_device()
        self.depth = wp.empty(shape, dtype=float, device="cpu")
        self.triangle = wp.empty(shape, dtype=int, device="cpu") if with_triangles else None

    def draw(self) -> float:
        """Milliseconds of one pass."""
        begin = time.perf_counter()
        self._rasteriser.draw(self._points, self._indices, self._view, self.depth, self.triangle, CULL_BACK)
        return (time.perf_counter() - begin) * 1e3


def draw_depth(bench: Bench, name: str, size: str) -> Iterator[Row]:
    """The depth map of a sun: an orthographic view of the whole mesh, depth only."""
    vertices, faces = spheres_on_terrain(bench.sizes.mixes[size])
    view = sun_view(vertices, bench.sizes.map_side)
    ours = OurTriangles(vertices, faces, view, False, bench.threads)

    note = f"{len(faces)} triangles, back faces culled, {view.width}x{view.height} depth; mismatch: coverage or depth"
    mismatch = depth_mismatch(lambda: ours.depth.numpy(), view)
    yield bench.beside_peer(name, ours.draw, lambda p: p.triangle_pass(vertices, faces, view, False), mismatch, note)


def draw_gbuffer(bench: Bench, name: str) -> Iterator[Row]:
    """A camera's view: depth and the triangle of each pixel."""
    vertices, faces = spheres_on_terrain(bench.sizes.mixes["250k"])
    view = eye_view(camera(), *bench.sizes.image, np.zeros(3))
    ours = OurTriangles(vertices, faces, view, True, bench.threads)

    def mismatch(other: Any) -> float:
        assert ours.triangle is not None
        return float((ours.triangle.numpy() != other.triangle()).mean())

    note = (
        f"{len(faces)} triangles, back faces culled, {view.width}x{view.height} depth and triangle; mismatch: triangle"
    )
    yield bench.beside_peer(name, ours.draw, lambda p: p.triangle_pass(vertices, faces, view, True), mismatch, note)


def filter_pcss(bench: Bench, name: str) -> Iterator[Row]:
    """The pixel pass of ``pcss`` with its defaults, G-buffer and map being there already."""
    ours = OurPcss(bench, bench.threads, bench.sizes.image)

    def make_peer(peer: Llvmpipe) -> Any:
        return peer.pcss_pass(*ours.peer_inputs(), **ours.peer_values())

    def mismatch(other: Any) -> float:
        mine, theirs = ours.visibility(), other.image()
        seen = np.isfinite(mine)
        return float((np.abs(mine - theirs)[seen] > TAP_TOLERANCE).mean())

    width, height = bench.sizes.image
    note = (
        f"16 + 16 taps, {width}x{height} pixels, {bench.sizes.map_side}^2 map, pixel pass only; mismatch: a tap or more"
    )
    yield bench.beside_peer(name, ours.draw, make_peer, mismatch, note)


class OurPcss:
    """A session whose products are built once, so that rendering again is the pixel pass and shading."""

    def __init__(self, bench: Bench, threads: int, image: tuple[int, int]) -> None:
        technique: Any = find("pcss")
        self._technique = technique(technique.Params(resolution=bench.sizes.map_side))
        scene = sunlit_scene(spheres_on_terrain(bench.sizes.mixes["soft"]), SUN_DEG, SOFT_CAMERA_HEIGHT)
        geometry = Geometry(scene, "cpu", threads)
        width, height = image
        self._session = Session(geometry, width=width, height=height, device="cpu", threads=threads)

    def draw(self) -> float:
        """Milliseconds of the shadow's pixel pass."""
        return self._session.render(self._technique).shadow_ms

    def visibility(self) -> np.ndarray:
        """float32 (H, W), NaN where no receiver is seen."""
        return self._session.render(self._technique).visibility

    def peer_inputs(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """The images and taps that ``Llvmpipe.pcss_pass`` takes."""
        params, gbuffer = self._technique.params, self._session.gbuffer()
        images = {
            "position_ws": _with_flag(gbuffer, gbuffer.position_ws, RECEIVES),
            "normal_ws": _with_flag(gbuffer, gbuffer.normal_ws, CASTS),
            "map_depth": depths_on_host(self._session.light_map(params.resolution, cull=params.cull).map)[0],
        }
        taps = {key: tap_set(params.kernel, getattr(params, key)) for key in ("blocker_taps", "filter_taps")}
        return images, taps

    def peer_values(self) -> dict[str, Any]:
        """The other uniforms of ``shaders.PCSS``."""
        params = self._technique.params
        light_map = self._session.light_map(params.resolution, cull=params.cull)
        footprint = pull_footprint(self._session, light_map)
        matrix = light_map.map.ws_to_ls.numpy()[0]
        per_length = 0.5 * params.resolution * np.linalg.norm(matrix[:2, :3], axis=1)
        return {
            "ws_to_ls": matrix,
            "to_light": self._session.light.centre[:3],
            "texels_per_ratio": np.diag(per_length * (1.0, -1.0)) @ footprint.half_axes.numpy()[0],
            "nearest_depth": footprint.nearest_depth.numpy()[0],
            "bias_slope": params.bias_slope,
            "rounding": float(ROUNDING),
            "border": float(BORDER),
            "resolution": params.resolution,
        }


def compare_threads(bench: Bench, name: str) -> Iterator[Row]:
    """Two threads beside one, in the rasteriser and in a pixel pass."""
    vertices, faces = spheres_on_terrain(bench.sizes.mixes["250k"])
    view = sun_view(vertices, bench.sizes.map_side)
    for part, make in (
        ("rasteriser", lambda threads: OurTriangles(vertices, faces, view, False, threads)),
        ("pcss", lambda threads: OurPcss(bench, threads, bench.sizes.image)),
    ):
        sides: list[Timed] = [make(threads).draw for threads in (2, 1)]
        two_ms, one_ms = interleaved_medians(sides, bench.repeats)
        yield Row(f"{name}.{part}", two_ms, "1 thread", one_ms, note="ours_ms with 2 threads")


def depth_mismatch(depth: Callable[[], np.ndarray], view: HostView) -> Callable[[Any], float]:
    """A function of the peer's pass: the share of pixels in which coverage or depth differ from ours."""

    def mismatch(other: Any) -> float:
        mine, theirs = depth(), other.depth()
        seen = np.isfinite(mine)
        with np.errstate(invalid="ignore"):  # inf - inf, where both see nothing
            apart = np.abs(mine - theirs) > DEPTH_TOLERANCE * (view.far - view.near)
        return float(((seen != np.isfinite(theirs)) | (seen & apart)).mean())

    return mismatch


def sun_view(vertices: np.ndarray, side: int) -> HostView:
    """The sun's view of all vertices, ``side`` texels wide and high."""
    box = Bounds()
    box.add(vertices)
    return scene_views(sun().centre, box, box, side)[0]


def _with_flag(gbuffer: GBuffer, image: wp.array, flag: int) -> np.ndarray:
    """A vec3 image with a flag of its pixels as fourth channel, float32 (H, W, 4)."""
    flags = (gbuffer.flags.numpy() & int(flag)) != 0
    return np.concatenate([image.numpy(), flags[..., None]], axis=2, dtype=np.float32)
