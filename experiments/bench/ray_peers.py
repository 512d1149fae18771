"""The peers of references: Mitsuba 3 (Embree's packets of rays, through Dr.Jit's LLVM backend) and embreex."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.bench.rows import PeerMissing
from wkernels.frame.session import Session
from wkernels.rays.single_rays import ORIGIN_ERROR
from wkernels.scene.geometry import CASTS, RECEIVES
from wkernels.scene.lights import DirectionalLight
from wkernels.scene.model import Camera

MITSUBA, EMBREEX = "Mitsuba ray_test", "embreex occluded"
MITSUBA_DIRECT = "Mitsuba direct"
_VARIANT = "llvm_ad_mono"
_SUN_DISTANCE = 50.0  # of Mitsuba's sun, a disc, in extents of the scene
_EMITTER_SAMPLES = 16  # per camera ray; more make Mitsuba's kernel longer, fewer repeat the camera rays


@dataclass(frozen=True)
class ShadowRays:
    """The rays of one frame's reference, as our kernels form them.

    Attributes:
        origin_ws: float32 (n, 3), receivers lifted off their surfaces, of the pixels that see some of the light.
        normal_ws: float32 (n, 3).
        lit_by_front: bool (n,): whether only light from the front counts, as on every surface that casts.
        pixel: int (n,), index into the image.
        light_ws: float32 (m, 4), the light's samples, neighbours in the set being neighbours on the light.
        shape: Height and width of the image.
    """

    origin_ws: np.ndarray
    normal_ws: np.ndarray
    lit_by_front: np.ndarray
    pixel: np.ndarray
    light_ws: np.ndarray
    shape: tuple[int, int]

    @property
    def count(self) -> int:
        """All rays, those from behind a surface included."""
        return len(self.origin_ws) * len(self.light_ws)

    def image(self, visibility: np.ndarray) -> np.ndarray:
        """Visibility of ``pixel`` as an image, float32 (H, W); other receivers see nothing of the light."""
        out = np.zeros(self.shape[0] * self.shape[1], dtype=np.float32)
        out[self.pixel] = visibility
        return out.reshape(self.shape)


def shadow_rays(session: Session, samples: int, kind: str) -> ShadowRays:
    """The rays of a session's current frame."""
    gbuffer, lights = session.gbuffer(), session.light_samples(samples, kind).host.astype(np.float32)
    receives = (gbuffer.flags.numpy() & int(RECEIVES)) != 0
    position, normal = gbuffer.position_ws.numpy()[receives], gbuffer.normal_ws.numpy()[receives]
    size = np.maximum(np.abs(position).max(axis=1), np.abs(gbuffer.depth.numpy()[receives]))
    casts = (gbuffer.flags.numpy()[receives] & int(CASTS)) != 0
    ahead = ~casts
    for light in lights:
        ahead |= np.einsum("ij,ij->i", normal, light[:3] - light[3] * position) > 0.0
    origin = position + normal * (float(ORIGIN_ERROR) * size)[:, None]
    pixel = np.flatnonzero(receives)[ahead]
    return ShadowRays(origin[ahead], normal[ahead], casts[ahead], pixel, _along_curve(lights), receives.shape)


class Mitsuba:
    """Mitsuba 3 with the casters of a session and its threads.

    Args:
        session: At the frame that is traced.
        threads: CPU threads.

    Raises:
        PeerMissing: It is not installed or has no LLVM to compile with.
    """

    def __init__(self, session: Session, threads: int) -> None:
        try:
            import drjit as dr
            import mitsuba as mi

            mi.set_variant(_VARIANT)
            mi.Float([1.0, 2.0]).numpy()
        except ImportError:
            raise PeerMissing("mitsuba is not installed; pip install 'wkernels[peers]'") from None
        except Exception as error:  # Dr.Jit finds no LLVM library only when it compiles
            raise PeerMissing(f"its variant {_VARIANT} does not run: {error}") from None
        mi.set_log_level(mi.LogLevel.Error)
        dr.set_thread_count(threads)
        self._mi, self._dr, self._session = mi, dr, session
        geometry = session.geometry
        vertices = geometry.points_ws.numpy()
        faces = geometry.caster_indices.numpy()
        mesh: Any = mi.Mesh("casters", vertex_count=len(vertices), face_count=len(faces) // 3)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.ravel()
        parameters["faces"] = faces.astype(np.uint32)
        parameters.update()
        self._mesh = mesh
        self._scene: Any = mi.load_dict({"type": "scene", "casters": mesh})

    def upload(self, rays: ShadowRays, most: int) -> MitsubaRays:
        """The rays' origins and lights, ready to be traced; about ``most`` of them, as they are held all at once."""
        return MitsubaRays(self._mi, self._dr, self._scene, rays, most)

    def direct(self, samples: int) -> MitsubaDirect:
        """The whole image by Mitsuba's integrator of direct light.

        Raises:
            PeerMissing: The light is no sun.
        """
        light = self._session.light
        if not isinstance(light, DirectionalLight):
            raise PeerMissing("this bench hands only suns to Mitsuba's integrator")
        mi, session = self._mi, self._session
        distance = _SUN_DISTANCE * session.reach
        radius = distance * float(np.tan(0.5 * light.size))
        transform = mi.ScalarTransform4f
        towards = transform().look_at(origin=(distance * light.centre[:3]).tolist(), target=[0, 0, 0], up=[0, 0, 1])
        sun = {"type": "disk", "to_world": towards @ transform().scale([radius, radius, 1.0])}
        sun |= {"emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}}
        scene = mi.load_dict({"type": "scene", "casters": self._mesh, "sun": sun})
        camera, origin = session.geometry.scene.camera(session.index), session.geometry.origin_ws
        film = {"type": "hdrfilm", "width": session.width, "height": session.height, "pixel_format": "luminance"}
        return MitsubaDirect(mi, self._dr, scene, _sensor(mi, camera, origin, film), samples)


class MitsubaRays:
    """See ``Mitsuba.upload``: all rays in one compiled kernel, those of a pixel side by side.

    Attributes:
        kept: Which of the rays' pixels are traced.
        share: How many of them, of all.
    """

    def __init__(self, mi: Any, dr: Any, scene: Any, rays: ShadowRays, most: int) -> None:
        self._mi, self._dr, self._scene = mi, dr, scene
        self.kept = slice(None, None, max(1, -(-rays.count // most)))
        origin, normal = rays.origin_ws[self.kept], rays.normal_ws[self.kept]
        self.share = len(origin) / max(len(rays.origin_ws), 1)
        self._samples, self._pixels = len(rays.light_ws), len(origin)
        columns = np.ascontiguousarray(origin.T), np.ascontiguousarray(normal.T)
        self._origin, self._normal = mi.Point3f(columns[0]), mi.Vector3f(columns[1])
        self._front = mi.Bool(np.ascontiguousarray(rays.lit_by_front[self.kept]))
        self._light = mi.Vector3f(np.ascontiguousarray(rays.light_ws[:, :3].T))
        self._here = mi.Float(np.ascontiguousarray(rays.light_ws[:, 3]))
        self._out: Any = None
        dr.eval(self._origin, self._normal, self._front, self._light, self._here)

    def draw(self) -> float:
        """Traces; milliseconds until every kept pixel's visibility is there, scaled to all."""
        mi, dr = self._mi, self._dr
        begin = time.perf_counter()
        index = dr.arange(mi.UInt32, self._pixels * self._samples)
        pixel, sample = index // self._samples, index % self._samples
        origin = dr.gather(mi.Point3f, self._origin, pixel)
        here = dr.gather(mi.Float, self._here, sample)
        way = dr.gather(mi.Vector3f, self._light, sample) - here * mi.Vector3f(origin)
        front = dr.dot(dr.gather(mi.Vector3f, self._normal, pixel), way) > 0.0
        front |= ~dr.gather(mi.Bool, self._front, pixel)
        end = dr.select(here > 0.0, mi.Float(1.0 - 1e-6), mi.Float(np.inf))
        hidden = self._scene.ray_test(mi.Ray3f(origin, way, end, 0.0, []), front)
        share = dr.select(front & ~hidden, mi.Float(1.0 / self._samples), mi.Float(0.0))
        self._out = dr.block_sum(share, self._samples)
        dr.eval(self._out)
        dr.sync_thread()
        return (time.perf_counter() - begin) * 1e3 / self.share

    def visibility(self) -> np.ndarray:
        """Of the pixels ``kept``, float32."""
        return np.array(self._out)


class MitsubaDirect:
    """See ``Mitsuba.direct``."""

    def __init__(self, mi: Any, dr: Any, scene: Any, sensor: Any, samples: int) -> None:
        self._mi, self._dr, self._scene, self._sensor = mi, dr, scene, sensor
        per_ray = min(_EMITTER_SAMPLES, samples)
        self._integrator = mi.load_dict({"type": "direct", "emitter_samples": per_ray, "bsdf_samples": 0})
        self._camera_rays, self._seed = -(-samples // per_ray), 0

    def draw(self) -> float:
        """Renders; milliseconds until the image is there."""
        begin = time.perf_counter()
        self._seed += 1
        image = self._mi.render(
            self._scene, sensor=self._sensor, integrator=self._integrator, spp=self._camera_rays, seed=self._seed
        )
        self._dr.eval(image)
        self._dr.sync_thread()
        return (time.perf_counter() - begin) * 1e3


class Embreex:
    """embreex, whose rays come one at a time, on some of the pixels.

    Args:
        session: Its geometry's casters are traced.
        rays: Their rays; every so many pixels are left out.
        threads: Python threads.
        most: About as many rays are traced.

    Attributes:
        share: Rays that are traced, of all.

    Raises:
        PeerMissing: It is not installed.
    """

    def __init__(self, session: Session, rays: ShadowRays, threads: int, most: int) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError:
            raise PeerMissing("embreex is not installed; pip install 'wkernels[peers]'") from None
        geometry = session.geometry
        self._scene = EmbreeScene()
        faces = geometry.caster_indices.numpy().reshape(-1, 3).astype(np.int32)
        self._mesh = TriangleMesh(self._scene, geometry.points_ws.numpy(), faces)
        self.kept = slice(None, None, max(1, rays.count // max(most, 1)))
        origin, normal = rays.origin_ws[self.kept], rays.normal_ws[self.kept]
        way = rays.light_ws[None, :, :3] - rays.light_ws[None, :, 3:] * origin[:, None]
        self._front = (np.einsum("ik,ijk->ij", normal, way) > 0.0) | ~rays.lit_by_front[self.kept, None]
        # like Mitsuba, only what is not behind the surface is traced
        origins = np.repeat(origin, len(rays.light_ws), axis=0)[self._front.ravel()]
        ways = way.reshape(-1, 3)[self._front.ravel()]
        self._parts = [
            (np.ascontiguousarray(a, dtype=np.float32), np.ascontiguousarray(b, dtype=np.float32))
            for a, b in zip(np.array_split(origins, threads), np.array_split(ways, threads), strict=True)
        ]
        self._lights_are_far = bool((rays.light_ws[:, 3] == 0.0).all())
        self.share = len(origin) / max(len(rays.origin_ws), 1)
        self._pool = ThreadPoolExecutor(threads)
        self._hits: list[np.ndarray] = []

    def draw(self) -> float:
        """Traces; milliseconds, scaled to all rays."""
        begin = time.perf_counter()
        jobs = [self._pool.submit(self._scene.run, *part, query="OCCLUDED") for part in self._parts]
        self._hits = [job.result() for job in jobs]
        return (time.perf_counter() - begin) * 1e3 / self.share

    def visibility(self) -> np.ndarray | None:
        """Of the pixels ``kept``, float32; None for lights within the scene, as embreex's rays do not end."""
        if not self._lights_are_far:
            return None
        seen = np.zeros(self._front.shape, dtype=bool)
        seen[self._front] = np.concatenate(self._hits) < 0
        return seen.mean(axis=1, dtype=np.float32)


def _sensor(mi: Any, camera: Camera, origin_ws: np.ndarray, film: dict[str, Any]) -> Any:
    place = mi.ScalarTransform4f().look_at(
        origin=(camera.eye - origin_ws).tolist(), target=(camera.target - origin_ws).tolist(), up=camera.up.tolist()
    )
    lens = {"fov": camera.fov_deg, "fov_axis": "y", "near_clip": camera.near, "far_clip": camera.far}
    content = {"type": "perspective", **lens, "to_world": place, "film": {**film, "rfilter": {"type": "box"}}}
    return mi.load_dict(content)


def _along_curve(lights: np.ndarray) -> np.ndarray:
    """The samples in the order of a space-filling curve (Morton 1966), so that a packet of rays stays together."""
    spread = np.maximum(np.ptp(lights[:, :3], axis=0), 1e-30)
    cells = ((lights[:, :3] - lights[:, :3].min(axis=0)) / spread * 1023.0).astype(np.int64)
    bits = np.arange(10)
    place = 3 * bits[:, None] + np.arange(3)
    return lights[np.argsort((((cells[:, None] >> bits[:, None]) & 1) << place).sum(axis=(1, 2)), kind="stable")]
