"""The Python calls: one technique's visibility of a scene, and the reference to hold it against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from algorithms.plugins import find
from algorithms.projections.composition import compose
from algorithms.projections.schema import Projection
from algorithms.technique import Technique
from experiments.config.source import from_dict, validate
from experiments.rendering.engine import check_device
from experiments.rendering.reference import ReferenceRenderer
from experiments.scenes import load_scene
from experiments.schema.needs import check_needs
from wkernels.errors import InputError, nearest
from wkernels.frame.session import FrameResult, LightViews, Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.model import Scene

SceneSource = str | Path | Mapping[str, Any] | Scene
MAX_PIXELS = 16384  # per side
MAX_SEED = 2**31 - 1


def render_visibility(
    scene: SceneSource,
    technique: str = "pcss",
    params: Mapping[str, Any] | None = None,
    projection: Mapping[str, Any] | None = None,
    frame: int = 0,
    frames: int = 1,
    width: int = 640,
    height: int = 360,
    light: int = 0,
    device: str = "cpu",
    seed: int = 1,
    *,
    threads: int | None = None,
    skips: bool = True,
    plugins: Sequence[str | Path] | Mapping[str, type[Technique]] = (),
) -> FrameResult:
    """Renders one frame of a scene with one technique.

    Args:
        scene: A scene file, its keys as a dict (files relative to the current folder), or a loaded scene.
        technique: Registered name.
        params: The technique's parameters by name; defaults for the rest.
        projection: Where light depth maps look, with the keys of an experiment file's ``projection``.
        frame: Frame of the scene's path, at least 0; frames behind its end hold its end.
        frames: How many frames are rendered, the last of them ``frame``: a method with history finds ``frames - 1``
            earlier ones. Where the path has no frame that early it holds its first.
        width, height: Pixels, 1 to 16384.
        light: Index of the light whose visibility is asked for.
        device: ``cpu`` or a CUDA device.
        seed: Seed of all sample sets, 0 to 2^31 - 1. Same seed, same bits on the CPU.
        threads: CPU threads; None for all. Never changes the result.
        skips: Whether work that the scene cannot need may be left out.
        plugins: Further plugin files, or a table of techniques by name.

    Returns:
        The last frame: ``visibility`` float32 (H, W), 1 = whole light visible, NaN where no receiver is seen;
        ``world_position`` float32 (H, W, 3), scene units; ``standard_error``, ``color``, times (of a first rendering,
        which loads kernels: no benchmark) and what was left out; see ``wkernels.frame.session.FrameResult``.

    Raises:
        InputError: Anything in the arguments or the scene is wrong, or the technique cannot work with the light.
    """
    frames = _whole("frames", frames, 1)
    chosen = _technique(technique, plugins)
    instance = chosen(validate(chosen.Params, from_dict({"params": dict(params or {})}), ("params",), foreign=True))
    light_views = _projection(projection)
    frame, width, height, light, seed = _numbers(frame, width, height, light, seed)
    threads = None if threads is None else _whole("threads", threads, 1)
    geometry = _geometry(scene, light, device, threads)
    for lamp in geometry.scene.lights if instance.all_lights else [geometry.scene.lights[light]]:
        check_needs(chosen, geometry.scene, lamp)
    session = Session(
        geometry,
        width=width,
        height=height,
        light_index=light,
        device=device,
        threads=threads,
        seed=seed,
        projection=light_views,
        skips=skips,
    )
    for index in range(frame - frames + 1, frame):
        session.begin(max(index, 0))
        session.render(instance)
        session.advance()
    session.begin(frame)
    return session.render(instance)


def reference_visibility(
    scene: SceneSource,
    samples: int = 256,
    frame: int = 0,
    width: int = 640,
    height: int = 360,
    light: int = 0,
    device: str = "cpu",
    seed: int = 1,
    *,
    threads: int | None = None,
    cache: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Ray-cast reference visibility of one frame.

    Args:
        scene: As for ``render_visibility``.
        samples: Points on the light, 1 to a million; a light without area takes one ray whatever is asked for.
        frame: Frame of the scene's path, at least 0.
        width, height: Pixels, 1 to 16384.
        light: Index of the light.
        device: ``cpu`` or a CUDA device.
        seed: Seed of the sample set, 0 to 2^31 - 1.
        threads: CPU threads; None for all. Never changes the result.
        cache: Whether a result of an earlier call with the same content may be read, and this one is stored.

    Returns:
        Visibility and its standard error, both float32 (H, W), NaN where no receiver is seen.

    Raises:
        InputError: Anything in the arguments or the scene is wrong.
    """
    frame, width, height, light, seed = _numbers(frame, width, height, light, seed)
    threads = None if threads is None else _whole("threads", threads, 1)
    geometry = _geometry(scene, light, device, threads)
    renderer = ReferenceRenderer(
        geometry,
        samples=samples,
        width=width,
        height=height,
        light=light,
        device=device,
        threads=threads,
        seed=seed,
        cache=cache,
    )
    reference = renderer.render(frame)
    return reference.visibility, reference.standard_error


def _numbers(frame: int, width: int, height: int, light: int, seed: int) -> tuple[int, int, int, int, int]:
    """The arguments that both calls share, as Python's numbers: NumPy's short ones would wrap around in sums."""
    return (
        _whole("frame", frame, 0),
        _whole("width", width, 1, MAX_PIXELS),
        _whole("height", height, 1, MAX_PIXELS),
        _whole("light", light, 0),
        _whole("seed", seed, 0, MAX_SEED),
    )


def _geometry(scene: SceneSource, light: int, device: str, threads: int | None) -> Geometry:
    """The scene on its device, once every argument that both calls share has been checked."""
    check_device(device)
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    if light >= len(loaded.lights):
        raise InputError(f"the scene has {len(loaded.lights)} light(s); there is no light {light}.", key="light")
    return Geometry(loaded, device, threads)


def _whole(name: str, value: int, least: int, most: int | None = None) -> int:
    """``value``, which may be NumPy's, as Python's int; raises InputError unless it is a whole number in the range."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or value < least or (most is not None and value > most):
        bounds = f"at least {least}" if most is None else f"from {least} to {most}"
        raise InputError(f"must be a whole number {bounds}, not {value!r}.", key=name)
    return int(value)


def _technique(name: str, plugins: Sequence[str | Path] | Mapping[str, type[Technique]]) -> type[Technique]:
    if not isinstance(plugins, Mapping):
        return find(name, [Path(file) for file in plugins])
    if name not in plugins:
        raise InputError(f"unknown technique '{name}'.{nearest(name, plugins)}")
    return plugins[name]


def _projection(projection: Mapping[str, Any] | None) -> LightViews | None:
    if projection is None:
        return None
    checked = validate(Projection, from_dict({"projection": dict(projection)}), ("projection",))
    return compose(checked.model_dump(by_alias=True))
