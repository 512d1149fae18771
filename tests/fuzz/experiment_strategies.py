"""Scene and experiment files that are right: what their models accept, small enough to be run at 16 x 9 pixels.

Three things are chosen here instead of being left to the models: sizes that only cost time; rules that span several
keys, so that most files run; and names that must be those of something else.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from model_strategies import Overrides, from_model, of_annotation, of_field
from pydantic import BaseModel

from algorithms.plugins import load_all
from algorithms.projections.schema import Projection
from experiments.kinds.analysis.config import AnalysisFile, CurveFile
from experiments.kinds.convergence.config import ConvergenceFile
from experiments.kinds.stability.cases import CASES
from experiments.kinds.stability.config import StabilityFile
from experiments.kinds.sweep.config import SweepFile
from experiments.kinds.walkthrough.config import WalkthroughFile
from experiments.metrics.registry import GROUPS, METRICS
from experiments.scenes import schema
from experiments.schema.models import FrameRange, Image, Reference, RunFile, ThirdPerson, Views
from experiments.schema.view_kinds import KINDS

WIDTH, HEIGHT = 16, 9
FILES: dict[str, type[BaseModel]] = {
    "walkthrough": WalkthroughFile,
    "sweep": SweepFile,
    "convergence": ConvergenceFile,
    "analysis": AnalysisFile,
    "stability": StabilityFile,
}
_LARGEST_MAP = 256  # texels per side, and the most samples, taps or layers of anything
_PLAIN_CURVE = {"warp": "none", "scheme": "practical", "warp_distance": None, "pseudo_near": 0.0, "pseudo_far": 0.0}
_SIZE = st.fixed_dictionaries({"width": st.just(WIDTH), "height": st.just(HEIGHT)})


@cache
def small() -> Overrides:
    """Fields whose values only cost time, kept small, and fields that must hold something in particular."""
    frame = st.integers(-2, 6)
    coordinate = of_annotation(schema.Coordinate, [], {})
    camera = st.lists(coordinate, min_size=3, max_size=3)
    return {
        (schema.Grid, "cells"): st.integers(1, 12),
        (schema.Sphere, "subdivisions"): st.integers(0, 3),
        (schema.MeshOptions, "name"): st.none(),
        (schema.MotionKeyframe, "frame"): frame,
        (schema.CameraKeyframe, "frame"): frame,
        (schema.PathOptions, "frames"): st.integers(1, 3),
        (schema.PathOptions, "file"): st.none(),
        (schema.Rectangle, "texture"): st.none(),
        (schema.Polygon, "texture"): st.none(),
        (schema.CameraOptions, "eye"): camera,
        (schema.CameraOptions, "target"): camera,
        (Image, "width"): st.just(WIDTH),
        (Image, "height"): st.just(HEIGHT),
        (Reference, "samples"): st.integers(1, 9),
        (Reference, "every"): st.integers(1, 3),
        (FrameRange, "start"): st.integers(0, 2),
        (FrameRange, "stop"): st.integers(3, 5),
        (FrameRange, "step"): st.integers(1, 2),
        (RunFile, "metrics"): st.none() | st.lists(st.sampled_from([*METRICS, *GROUPS]), max_size=4, unique=True),
        (RunFile, "baseline"): st.none(),
        (RunFile, "repeats"): st.integers(1, 2),
        (RunFile, "frames"): st.none() | st.integers(1, 3),
        (RunFile, "lead_in"): st.just(0),
        (RunFile, "light"): st.sampled_from([0, 0, 0, 1]),
        (Views, "frames"): st.none() | st.just([0]),
        (Views, "kinds"): st.just("all")
        | st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=2, unique=True),
        (Views, "labels"): st.none(),
        (Views, "modes"): st.lists(st.sampled_from(["det", "x", "y"]), min_size=1, unique=True),
        (Views, "image"): _SIZE,
        (Views, "third_person"): from_model(ThirdPerson, {(ThirdPerson, "eye"): st.none()}),
        (ThirdPerson, "up"): st.none() | st.just([0, 0, 1]),
        (ConvergenceFile, "steps"): st.sampled_from([[1], [1, 2], [1, 3], [2, 4]]),
        (ConvergenceFile, "frame"): st.integers(0, 2),
        (ConvergenceFile, "crop"): st.none() | st.just({"x": 0, "y": 1, "width": 9, "height": 5}),
        (ConvergenceFile, "light"): st.just(0),
        (CurveFile, "published"): st.none(),
        **{(CurveFile, key): st.just(value) for key, value in _PLAIN_CURVE.items()},
    }


@cache
def plugins() -> dict[str, Any]:
    """All techniques by name."""
    return dict(load_all())


# ---- Scenes ---------------------------------------------------------------------------------------------------------


@cache
def scenes() -> SearchStrategy[dict[str, Any]]:
    """Scenes of one to four meshes, mostly with a ground to receive shadows, and one or two lights."""
    meshes = st.one_of([from_model(model, small()) for model in schema.PRIMITIVES.values()])
    lights = st.one_of([from_model(model, small()) for model in schema.LIGHTS.values()])

    @st.composite
    def scene(draw: st.DrawFn) -> dict[str, Any]:
        out: dict[str, Any] = {"meshes": [], "lights": draw(st.lists(lights, min_size=1, max_size=2))}
        if draw(st.floats(0.0, 1.0)) < 0.8:
            out["meshes"].append({"primitive": "plane", "size": [12, 12]})
        out["meshes"] += draw(st.lists(meshes, min_size=1, max_size=3))
        for item in [*out["meshes"], *out["lights"]]:
            if item.get("motion"):
                item["motion"]["keyframes"] = _rising(item["motion"]["keyframes"])
        for light in out["lights"]:
            _suit(light)
        out["camera"] = draw(_cameras())
        if draw(st.floats(0.0, 1.0)) < 0.3:
            out["path"] = draw(_paths())
        return out

    return scene()


@cache
def _cameras() -> SearchStrategy[dict[str, Any]]:
    ordinary = st.just({"eye": [0.0, 6.0, 9.0], "target": [0.0, 0.0, 0.0]})

    @st.composite
    def camera(draw: st.DrawFn) -> dict[str, Any]:
        out = draw(ordinary) | draw(from_model(schema.CameraOptions, small()))
        if out.get("projection") == "orthographic":
            out.pop("fov_deg", None)
            out["height"] = out.get("height") or 8.0
        else:
            out.pop("height", None)
        if out.get("near") and out.get("far") and not out["near"] < out["far"]:
            del out["far"]
        return out

    return ordinary | camera()


@cache
def _paths() -> SearchStrategy[dict[str, Any]]:
    keyframes = st.lists(from_model(schema.CameraKeyframe, small()), min_size=1, max_size=3).map(_rising)
    orbit = from_model(schema.Orbit, small())
    frames = st.integers(1, 3)
    return st.fixed_dictionaries({"frames": frames, "keyframes": keyframes}) | st.fixed_dictionaries(
        {"frames": frames, "orbit": orbit}
    )


def _rising(keyframes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    by_frame = {key["frame"]: key for key in keyframes}
    return [by_frame[frame] for frame in sorted(by_frame)]


def _suit(light: dict[str, Any]) -> None:
    """What a kind of light asks of its own keys together."""
    if light["kind"] == "polygon":
        light["vertices"] = [[-1.0, 6.0, 0.0], [1.0, 6.0, 0.0], [0.5, 6.0, 1.5]]
    for key in (light.get("motion") or {}).get("keyframes", ()):
        if light["kind"] == "directional":
            key.pop("translate", None)
            key.pop("scale", None)
        elif light["kind"] in ("disc", "sphere") and "scale" in key:
            key["scale"] = key["scale"] if not isinstance(key["scale"], list) else key["scale"][0]


# ---- Experiments ----------------------------------------------------------------------------------------------------


def techniques(names: tuple[str, ...]) -> SearchStrategy[list[Any]]:
    """One or two entries of ``techniques``, with parameters of their models."""
    entries = [_entry(name) for name in names]
    return st.lists(st.one_of(entries), min_size=1, max_size=2, unique_by=lambda entry: next(iter(entry)))


def _entry(name: str) -> SearchStrategy[dict[str, Any]]:
    params: type[BaseModel] = plugins()[name].Params
    overrides: dict[tuple[type[BaseModel], str], SearchStrategy] = {}
    for key, field in params.model_fields.items():
        if field.annotation is int:
            overrides[params, key] = of_field(params, key, field, {}).map(
                lambda value, default=field.default: value if value <= _LARGEST_MAP else min(default, _LARGEST_MAP)
            )
    return from_model(params, overrides, optional=0.2).map(lambda options: {name: options})


@cache
def experiments(kind: str, names: tuple[str, ...]) -> SearchStrategy[dict[str, Any]]:
    """Experiment files of a kind, with techniques from ``names``."""
    model = FILES[kind]
    own: dict[tuple[type[BaseModel], str], SearchStrategy] = {
        (model, "techniques"): techniques(names),
        (model, "scene"): scenes(),
        (model, "scenes"): st.none(),
        (model, "budgets"): st.none(),
        (RunFile, "projection"): _projections(),
        (ConvergenceFile, "projection"): _projections(),
        (RunFile, "reference"): from_model(Reference, small()).map(_centre),
        (ConvergenceFile, "reference"): from_model(Reference, small()).map(_centre),
    }
    if kind == "stability":
        own[model, "techniques"] = st.lists(st.sampled_from(names), min_size=1, max_size=3, unique=True)
        own[model, "cases"] = st.lists(st.sampled_from(sorted(CASES)), min_size=1, max_size=3, unique=True)
    made = from_model(model, {**small(), **own})
    if kind == "analysis":
        return made.map(_with_depth)
    return made.map(lambda data: _whole(kind, data)) if "scene" in model.model_fields else made


def _whole(kind: str, data: dict[str, Any]) -> dict[str, Any]:
    """What several keys of an experiment ask of each other."""
    if kind == "sweep":
        data.setdefault(
            "scene", {"meshes": [{"primitive": "plane", "size": [9, 9]}], "lights": [_LAMP], "camera": _EYE}
        )
        data.pop("scenes", None)
    data["reference"] = data.get("reference") or {"samples": 4}
    if data.get("light", 0) >= len(data["scene"]["lights"]):
        data["light"] = 0
    return data


def _with_depth(data: dict[str, Any]) -> dict[str, Any]:
    camera = data["camera"]
    near, far = sorted((camera["near"], camera["far"]))
    if not near < far:
        near, far = 1.0, 1e3
    for curve in data["curves"]:
        curve.pop("near", None)
        curve.pop("far", None)
    return {**data, "camera": {**camera, "near": near, "far": far}}


_LAMP = {"kind": "rectangle", "center": [0, 6, 0], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}
_EYE = {"eye": [0, 6, 9], "target": [0, 0, 0]}


def _centre(reference: dict[str, Any]) -> dict[str, Any]:
    return {**reference, "samples": 1} if reference.get("light") == "centre" else reference


def _projections() -> SearchStrategy[Any]:
    """Few keys at a time: most pairs of them do not go together."""
    return st.none() | from_model(Projection, {}, optional=0.08)
