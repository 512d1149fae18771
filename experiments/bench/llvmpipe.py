"""The peer: Mesa's llvmpipe, software OpenGL that compiles shaders to SIMD code, through moderngl."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from experiments.bench import shaders
from experiments.bench.rows import PeerMissing
from wkernels.scene.views import HostView

MAX_DEVICES = 8  # EGL devices that are asked; a GPU's driver may come first
NAME = "llvmpipe"


class Llvmpipe:
    """An OpenGL context on llvmpipe; ``close`` ends it.

    Args:
        threads: Threads that shade and rasterise, at least 1 (vertices are the calling thread's work).

    Raises:
        PeerMissing: moderngl or llvmpipe is not installed.
    """

    def __init__(self, threads: int) -> None:
        self._context = _open_context(threads)
        info = self._context.info
        self.description = f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"

    def close(self) -> None:
        """Frees the context."""
        self._context.release()

    def triangle_pass(
        self, vertices: np.ndarray, faces: np.ndarray, view: HostView, with_triangles: bool, cull: bool = True
    ) -> TrianglePass:
        """A pass that draws triangles into depth, and their numbers if wanted.

        Args:
            vertices: float32 (V, 3).
            faces: int32 (F, 3).
            view: Size and projection.
            with_triangles: Whether there is an integer target besides the depth.
            cull: Whether back faces are left out.
        """
        return TrianglePass(self._context, vertices, faces, view, with_triangles, cull)

    def pcss_pass(self, images: Mapping[str, np.ndarray], taps: Mapping[str, np.ndarray], **values: Any) -> PixelPass:
        """Percentage-closer soft shadows of every pixel.

        Args:
            images: float32 ``position_ws`` and ``normal_ws`` (H, W, 4), ``map_depth`` (R, R).
            taps: ``blocker_taps`` and ``filter_taps``, float (n, 2).
            **values: The other uniforms of ``shaders.PCSS``: numbers, vectors and matrices.
        """
        source = shaders.PCSS
        for name, offsets in taps.items():
            source = source.replace(name.upper(), str(len(offsets)))
        return PixelPass(self._context, source, images, {**taps, **values})


class TrianglePass:
    """See ``Llvmpipe.triangle_pass``."""

    def __init__(
        self,
        context: Any,
        vertices: np.ndarray,
        faces: np.ndarray,
        view: HostView,
        with_triangles: bool,
        cull: bool,
    ) -> None:
        import moderngl

        self._context, self._view = context, view
        self._state = moderngl.DEPTH_TEST | (moderngl.CULL_FACE if cull else 0)
        fragment = shaders.TRIANGLE if with_triangles else shaders.DEPTH_ONLY
        program = context.program(vertex_shader=shaders.VERTEX, fragment_shader=fragment)
        program["ws_to_clip"].write(_column_major(clip_matrix(view)))
        points = context.buffer(np.ascontiguousarray(vertices, dtype=np.float32).tobytes())
        indices = context.buffer(np.ascontiguousarray(faces, dtype=np.int32).tobytes())
        self._array = context.vertex_array(program, [(points, "3f", "position_ws")], indices)
        size = (view.width, view.height)
        self._depth = context.depth_texture(size)
        self._triangle = context.texture(size, 1, dtype="i4") if with_triangles else None
        self._target = context.framebuffer([self._triangle] if with_triangles else [], self._depth)

    def draw(self) -> float:
        """Clears and draws; milliseconds until the image is complete."""
        self._target.use()
        self._context.enable_only(self._state)
        begin = time.perf_counter()
        self._target.clear(depth=1.0)
        self._array.render()
        self._context.finish()
        return (time.perf_counter() - begin) * 1e3

    def depth(self) -> np.ndarray:
        """Linear depth, float64 (H, W), row 0 at the top, +inf where there is nothing."""
        shape = (self._view.height, self._view.width)
        stored = np.frombuffer(self._depth.read(alignment=1), dtype=np.float32).reshape(shape)[::-1].astype(float)
        near, far = self._view.near, self._view.far
        if self._view.perspective:
            linear = near * far / (far - stored * (far - near))
        else:
            linear = near + stored * (far - near)
        return np.where(stored < 1.0, linear, np.inf)

    def triangle(self) -> np.ndarray:
        """Triangle of each pixel, int32 (H, W), row 0 at the top, -1 where there is none."""
        assert self._triangle is not None
        shape = (self._view.height, self._view.width)
        return np.frombuffer(self._triangle.read(alignment=1), dtype=np.int32).reshape(shape)[::-1] - 1


class PixelPass:
    """A full-screen pass over images; see ``Llvmpipe.pcss_pass``. Rows stay in the order of the images."""

    def __init__(
        self, context: Any, source: str, images: Mapping[str, np.ndarray], uniforms: Mapping[str, Any]
    ) -> None:
        import moderngl

        self._context, self._mode = context, moderngl.TRIANGLES
        program = context.program(vertex_shader=shaders.FULL_SCREEN, fragment_shader=source)
        self._textures = []
        for unit, (name, image) in enumerate(images.items()):
            channels = 1 if image.ndim == 2 else image.shape[2]
            data = np.ascontiguousarray(image, dtype=np.float32).tobytes()
            texture = context.texture(image.shape[1::-1], channels, data, dtype="f4", alignment=1)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._textures.append(texture)
            program[name].value = unit
        for name, value in uniforms.items():
            array = np.asarray(value, dtype=np.float32)
            matrix = array.ndim == 2 and array.shape[0] == array.shape[1] and not name.endswith("_taps")
            program[name].write(_column_major(array) if matrix else array.tobytes())
        self._array = context.vertex_array(program, [])
        self._shape = images["position_ws"].shape[:2]
        self._out = context.texture(self._shape[::-1], 1, dtype="f4")
        self._target = context.framebuffer([self._out])

    def draw(self) -> float:
        """Runs the pass; milliseconds until the image is complete."""
        self._target.use()
        self._context.enable_only(0)
        for unit, texture in enumerate(self._textures):
            texture.use(unit)
        begin = time.perf_counter()
        self._array.render(self._mode, vertices=3)
        self._context.finish()
        return (time.perf_counter() - begin) * 1e3

    def image(self) -> np.ndarray:
        """What the pass wrote, float32 (H, W)."""
        return np.frombuffer(self._out.read(alignment=1), dtype=np.float32).reshape(self._shape)


def clip_matrix(view: HostView) -> np.ndarray:
    """OpenGL's clip coordinates of a view, float64 (4, 4): its screen position, depth from -w (near) to w (far)."""
    rows = view.ws_to_ss.copy()
    near, far = view.near, view.far
    if view.perspective:
        rows[2] *= (far + near) / (far - near)
        rows[2, 3] -= 2.0 * far * near / (far - near)
    else:
        rows[2] *= 2.0 / (far - near)
        rows[2, 3] -= (far + near) / (far - near)
    return rows


def _column_major(matrix: np.ndarray) -> bytes:
    return np.ascontiguousarray(matrix.T, dtype=np.float32).tobytes()


def _open_context(threads: int) -> Any:
    try:
        import moderngl
    except ImportError:
        raise PeerMissing("moderngl is not installed; pip install 'wkernels[peers]'") from None
    refusals: list[str] = []
    wanted = {"LIBGL_ALWAYS_SOFTWARE": "1", "GALLIUM_DRIVER": "llvmpipe", "LP_NUM_THREADS": str(threads)}
    with _environment(wanted):
        for index in range(MAX_DEVICES):
            backend: dict[str, Any] = {"backend": "egl", "device_index": index}
            try:
                context = moderngl.create_context(require=330, standalone=True, **backend)
            except Exception as error:  # moderngl raises plain Exception
                refusals.append(str(error).strip())
                break
            renderer = str(context.info["GL_RENDERER"])
            if renderer.startswith("llvmpipe"):
                return context
            context.release()
            refusals.append(f"device {index} is {renderer}")
    raise PeerMissing(f"EGL offers no llvmpipe ({'; '.join(refusals)}); on Debian: libegl1 and libgl1-mesa-dri")


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Mesa reads its settings from the environment while the context opens."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
