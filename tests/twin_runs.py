"""Everything that sends twins to work, and what watching them says: how far the plain kernel's outputs are."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import small_scenes as small
import warp as wp

from algorithms.plugins import find
from algorithms.projections.composition import compose
from experiments.scenes.loader import load_scene
from wkernels.device.twin import Twin
from wkernels.filters import blur
from wkernels.filters.map_images import new_image
from wkernels.filters.mips import find_mips
from wkernels.filters.penumbra import pull_footprint
from wkernels.filters.pyramid import pull_pyramid
from wkernels.filters.texels import DOUBLE, components
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import Light, SphereLight
from wkernels.scene.model import Scene

LIGHTS: dict[str, Light] = {
    "perspective": small.light("rectangle"),
    "orthographic": small.light("directional"),
    "six faces": SphereLight(center=np.array([0.2, 3.2, 1.5]), radius=0.2),
}
BIASES = ("none", "constant", "slope", "back_face", "slope_back_face", "normal")
SPLITS = {
    "depth": {"fit": "focused", "splits": 4, "scheme": "log"},
    "best, atlas": {"fit": "focused", "splits": 4, "scheme": "log", "selection": "best", "storage": "atlas9"},
    "warped": {"fit": "focused", "splits": 4, "scheme": "log", "warp": "lispsm_nopt"},
    "warped, best": {"fit": "focused", "splits": 8, "warp": "lispsm_nrepar", "selection": "best"},
    "tight": {"fit": "focused", "splits": 2, "depth": "tight"},
}
STILL: list[tuple[str, dict[str, Any]]] = [
    ("shadow_map", {}),
    ("pcf", {}),
    ("pcf", {"bilinear": False, "kernel": "box", "taps": 9, "radius": 8.0}),
    ("pcf_blocker_skip", {}),
    ("pcf_blocker_skip", {"search": "disc", "search_taps": 16, "bilinear": False}),
    ("pcf_split_kernel", {}),
    ("pcf_split_kernel", {"scale": "layer", "bilinear": False}),
    ("pcss", {}),
    ("pcss", {"rotate": True, "bilinear": True}),
    ("pcss", {"kernel": "box", "blocker_taps": 9, "filter_taps": 25}),
    ("multi_shadow_map", {"samples": 3}),
    ("vsm", {}),
    ("vsm", {"taps": 21, "bleeding": 0.2}),
    ("projection_aliasing_mitigation", {}),
    ("shadow_volume_zfail", {}),
    ("shadow_volume_zpass", {"shadowed": "nonzero"}),
    ("penumbra_maps", {}),
    ("smoothies", {}),
    ("wedge_spherical", {}),
    ("wedge_rectangular", {}),
]
OVER_TIME: list[tuple[str, dict[str, Any]]] = [
    ("tc_hard", {}),
    ("tc_hard", {"scale_bias": True}),
    ("tc_hard", {"blend": "published", "power": 4}),
    ("tc_hard", {"history": "nearest", "bias": "normal"}),
    ("tc_adaptive", {}),
    ("tc_adaptive", {"samples": 8}),
    ("tc_soft_paper", {}),
    ("tc_soft_paper", {"start": "sample"}),
    ("tc_soft_paper", {"history": "nearest", "filter_width": "penumbra"}),
    ("tc_soft_paper", {"movers": "gradual", "start_weight": 4.0, "mover_surfaces": "own_motion"}),
    ("tc_soft_paper", {"movers": "at_once", "start": "sample"}),
    ("tc_soft_paper", {"ageing": "frames", "age_factor": 0.7}),
    ("tc_soft_paper", {"mover_map": "centre"}),
    ("tc_soft_paper", {"kept_views": 3, "kept_overlap": 0.97}),
    ("tc_soft_thesis", {"mover_map": "centre", "mover_overlap": "max", "mover_taps": 9}),
    ("tc_soft_thesis", {}),
    ("tc_soft_thesis", {"start": "blur", "blocker_mean": "frames", "mover_surfaces": "own_motion"}),
    ("tc_soft_thesis", {"start": "blur", "movers": "at_once", "kernel": "poisson", "zero_blur": "rejected"}),
]


@dataclass
class Seen:
    """What was seen of one twin.

    Attributes:
        values: How many values were compared.
        differing: How many of them the two kernels do not agree on, within the twin's tolerance.
        faults: What went beyond the twin's bounds in one launch, with the run it happened in.
        distinct: Whether any output had more than one value: constant images agree too easily.
    """

    values: int = 0
    differing: int = 0
    faults: list[str] = field(default_factory=list)
    distinct: bool = False


def _arrays(twin: Twin, outputs: Sequence[Any]) -> list[wp.array]:
    return list(twin.compared(*outputs) if twin.compared else outputs)


class Watcher:
    """Has the plain kernel write beside the lanes, into copies of their outputs, and compares when the lanes are done."""

    def __init__(self) -> None:
        self.seen: dict[str, Seen] = defaultdict(Seen)
        self.run = ""

    def __call__(
        self, twin: Twin, run_plain: Callable[[Sequence[Any]], None], outputs: Sequence[Any]
    ) -> Callable[[], None]:
        copies = [wp.clone(output) for output in outputs]
        run_plain(copies)
        return lambda: self._compare(twin, _arrays(twin, copies), _arrays(twin, outputs))

    def _compare(self, twin: Twin, plain: list[wp.array], lanes: list[wp.array]) -> None:
        entry = self.seen[twin.name]
        for a, b in zip(plain, lanes, strict=True):
            x, y = (np.ascontiguousarray(array.numpy()).astype(float).ravel() for array in (a, b))
            same = (x == y) | (np.isnan(x) & np.isnan(y))
            with np.errstate(invalid="ignore"):
                close = np.abs(x - y) <= twin.tolerance * np.maximum(1.0, np.abs(x))
            differing = int((~(same | close)).sum())
            entry.values += x.size
            entry.differing += differing
            entry.distinct |= x.size > 0 and bool((x != x[0]).any())
            if differing > twin.flips * x.size:
                entry.faults.append(f"{self.run}: {differing} of {x.size} values differ")


def session(scene: Scene, width: int = 100, height: int = 60, **options: Any) -> Session:
    return Session(Geometry(scene, "cpu"), width=width, height=height, **options)


def _render(running: Session, name: str, params: dict[str, Any], frames: Sequence[int] = (0,)) -> None:
    technique = find(name)
    small_map = {"resolution": 256} if "resolution" in technique.Params.model_fields else {}
    made = technique(technique.Params(**{**small_map, **params}))
    for frame in frames:
        running.begin(frame)
        running.render(made)
        running.advance()


def runs() -> Iterator[tuple[str, Callable[[], None]]]:
    """Every run: its name, and what it does."""
    for (name, params), lamp in product(STILL, LIGHTS):
        if LIGHTS[lamp].kind not in find(name).needs.lights:
            continue
        yield (
            f"{name} {params} {lamp}",
            lambda n=name, p=params, k=lamp: _render(session(small.cluttered(LIGHTS[k])), n, p),
        )
    for lamp in LIGHTS:
        yield f"plateaus {lamp}", lambda k=lamp: _render(session(small.box_on_ground(LIGHTS[k])), "plateaus", {})
    for name, split, lamp in product(
        ("pcf", "pcf_split_kernel", "pcss", "shadow_map", "vsm", "tc_hard"), SPLITS, ("perspective", "orthographic")
    ):
        yield (
            f"{name} {split} {lamp}",
            lambda n=name, s=split, k=lamp: _render(
                session(small.cluttered(LIGHTS[k]), projection=compose(SPLITS[s])), n, {"resolution": 128}
            ),
        )
    for name, bias, lamp in product(("pcf", "pcss", "shadow_map"), BIASES, LIGHTS):
        yield (
            f"{name} {bias} {lamp}",
            lambda n=name, b=bias, k=lamp: _render(
                session(small.cluttered(LIGHTS[k])), n, {"bias": b, "bias_constant": 2.0}
            ),
        )
    for name, width in product(("pcf", "pcss", "shadow_map", "vsm"), (1, 15, 16, 17, 63)):
        yield (
            f"{name} {width} wide",
            lambda n=name, x=width: _render(session(small.cluttered(LIGHTS["perspective"]), x, 50), n, {}),
        )
    small_ground = small.scene([small.mesh("ground", small.plane(6.0))], LIGHTS["perspective"])
    for name in ("pcf", "pcss", "shadow_map"):
        yield f"{name} at the map's end", lambda n=name: _render(session(small_ground), n, {"resolution": 16})
        yield (
            f"{name} overlap",
            lambda n=name: _render(session(loaded("overlap"), 150, 84), n, {"resolution": 1024}),
        )
    for near in ("auto", "auto_previous"):
        yield (
            f"near {near}",
            lambda p={"fit": "focused", "near": near}: _render(
                session(loaded("overlap"), 150, 84, projection=compose(p), skips=False),
                "shadow_map",
                {},
                range(0, 60, 5),
            ),
        )
    for scene, (name, params) in product(("overlap", "moving_blocker", "moving_light"), OVER_TIME):
        if scene == "moving_light" and name == "tc_adaptive":
            continue  # it needs a still light
        yield (
            f"{name} {params} {scene}",
            lambda n=name, p=params, s=scene: _render(session(loaded(s), 150, 84), n, p, range(0, 60, 5)),
        )
    roof = small.mesh("roof", small.box((0.0, 60.0, 0.0), (3.0, 0.5, 3.0)), receives=False)
    roofed = small.scene([small.mesh("ground", small.plane(14.0)), roof], LIGHTS["orthographic"])
    for resolution in (48, 50, 256):
        yield (
            f"clamped casters {resolution}",
            lambda r=resolution: _render(
                session(roofed, projection=compose(SPLITS["tight"])), "shadow_map", {"resolution": r}
            ),
        )
    for resolution, lamp in product((8, 64, 100), ("perspective", "six faces")):
        yield f"tags and blockers {resolution} {lamp}", lambda r=resolution, k=lamp: _maps(r, LIGHTS[k])
        yield f"pyramids {resolution} {lamp}", lambda r=resolution, k=lamp: _pyramids(r, LIGHTS[k])
    for dtype, shape, radius in product(DOUBLE, ((9, 16), (30, 33), (40, 100), (3, 500)), (0, 2, 40)):
        yield f"blur {dtype.__name__} {shape} {radius}", lambda d=dtype, s=shape, r=radius: _blur(d, s, r)


@lru_cache
def loaded(name: str) -> Scene:
    return load_scene(f"configs/scenes/{name}.yaml")


def _maps(resolution: int, light: Light) -> None:
    boxes = small.mesh("boxes", small.random_boxes(9, 2), moving=True)
    running = session(small.scene([small.mesh("ground", small.plane(14.0)), boxes], light), 16, 16, threads=3)
    pull_footprint(running, running.light_map(resolution, tag_moving_casters=True))


def _pyramids(resolution: int, light: Light) -> None:
    running = session(small.cluttered(light), 16, 16, threads=3)
    light_map = running.light_map(resolution)
    pull_pyramid(running, light_map)
    for texel in DOUBLE:
        image = new_image(running, light_map.layout, texel, None)
        texels = np.random.default_rng(1).normal(size=image.texels.numpy().shape)
        image.texels.assign(wp.array(texels, dtype=texel, device="cpu"))
        find_mips(running, image)


def _blur(dtype: Any, shape: tuple[int, int], radius: int) -> None:
    values = np.random.default_rng(3).normal(size=(*shape, components(dtype))).astype(np.float32).squeeze()
    blur.separable_blur(wp.array(values, dtype=dtype, device="cpu"), blur.gaussian_weights(radius), threads=2)


@lru_cache(maxsize=1)
def watched() -> dict[str, Seen]:
    """What all runs together say of each twin, by its name."""
    watcher = Watcher()
    with Twin.watched(watcher):
        for name, run in runs():
            watcher.run = name
            run()
    return dict(watcher.seen)
