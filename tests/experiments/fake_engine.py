"""A renderer without pixels to draw: it answers the runner at once, deterministically, and can fail or stop on demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from algorithms.technique import Needs
from experiments.schema.experiment import Experiment
from experiments.schema.models import Image, Reference
from experiments.schema.techniques import TechniqueRun
from wkernels.analysis.sampling_rate import MapUse, SamplingRate
from wkernels.frame.session import FrameResult
from wkernels.scene.lights import RectangleLight
from wkernels.scene.model import Camera, Mesh, Scene
from wkernels.scene.views import eye_view

WIDTH, HEIGHT = 24, 16


class Flat:
    """Reference plus a constant error."""

    name, family, paper, bias_sign = "flat", "hard", ("williams1978",), "none"
    needs = Needs(lights=frozenset({"rectangle"}))

    class Params(BaseModel):
        error: float = 0.1
        ms: float = 4.0
        fails_on: int = -1
        own_error: bool = False

    products = ()

    def __init__(self, params: Params) -> None:
        self.params = params

    def leaves_out(self) -> tuple[()]:
        return ()


class Remembering(Flat):
    """Its error depends on every frame since the reset."""

    name, family = "remembering", "temporal"
    needs = Needs(lights=frozenset({"rectangle"}), area=True, history=True)


PLUGINS = {"flat": Flat, "remembering": Remembering}


def camera(frame: int) -> Camera:
    eye = np.array([0.02 * frame, 2.0, 5.0])
    return Camera(eye, eye + np.array([0.0, -0.5, -1.0]), np.array([0.0, 1.0, 0.0]), 50.0, 0.1, 100.0)


def make_scene(frames: int = 6) -> Scene:
    floor = Mesh(
        "floor", np.array([[-9.0, 0, -9], [-9, 0, 9], [9, 0, 9], [9, 0, -9]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    light = RectangleLight(center=np.array([0.0, 9, 0]), edge_u=np.array([2.0, 0, 0]), edge_v=np.array([0.0, 0, 2]))
    return Scene("fake", (floor,), (light,), camera, frames, "0123456789abcdef")


def floor_positions(frame: int) -> np.ndarray:
    """World positions of the floor y = 0 at each pixel, NaN above the horizon, float32 (H, W, 3)."""
    view = eye_view(camera(frame), WIDTH, HEIGHT, np.zeros(3))
    left, right, bottom, top = view.window
    x = left + (np.arange(WIDTH) + 0.5) / WIDTH * (right - left)
    y = top + (np.arange(HEIGHT) + 0.5) / HEIGHT * (bottom - top)
    along = view.forward_ws + x[None, :, None] * view.right_ws + y[:, None, None] * view.up_ws
    depth = np.where(along[..., 1] < 0.0, -view.eye_ws[1] / along[..., 1], np.nan)
    return (view.eye_ws + depth[..., None] * along).astype(np.float32)


def true_visibility(frame: int) -> np.ndarray:
    position = floor_positions(frame)
    visibility = 0.5 + 0.3 * np.sin(position[..., 0]) * np.cos(position[..., 2])
    visibility[0] = np.nan  # the first row sees no receiver
    return visibility.astype(np.float32)


class FakeSession:
    def __init__(self, on_render: Callable[[int], None], log: list[Any], label: str) -> None:
        self.on_render, self.log, self.label = on_render, log, label
        self.frame, self.repeat = -1, 0
        self.committed: list[int] = []

    def reset(self) -> None:
        self.frame, self.repeat = -1, 0
        self.committed = []
        self.log.append((self.label, "reset"))

    def begin(self, frame_index: int) -> None:
        self.repeat = self.repeat + 1 if frame_index == self.frame else 0
        self.frame = frame_index

    def advance(self) -> None:
        self.committed.append(self.frame)
        self.repeat = -1

    def render(self, technique: Flat) -> FrameResult:
        self.log.append((self.label, self.frame))
        self.on_render(self.frame)
        p = technique.params
        if p.fails_on == self.frame:
            raise ValueError("deliberate,\nover two lines")
        error = p.error
        if technique.needs.history:
            error += 0.01 * sum(frame + 1 for frame in self.committed)
        truth = true_visibility(self.frame)
        visibility = np.clip(truth + np.float32(error), 0.0, 1.0)
        ms = p.ms + 0.25 * self.frame + (0.5, 0.0, 1.0)[self.repeat % 3]
        kept = [("depth map", "its inputs have not changed", 1)] if self.committed else []
        color = np.repeat(np.nan_to_num(visibility)[..., None], 3, axis=2)
        standard_error = np.where(np.isnan(truth), np.nan, 0.02).astype(np.float32) if p.own_error else None
        return FrameResult(
            visibility, color, standard_error, floor_positions(self.frame),
            [("g-buffer", 1.0), ("compare", ms - 1.5), ("shading", 0.5)], ms, ms - 1.5, kept, float("nan"), 2.0,
        )  # fmt: skip


@dataclass
class FakeEngine:
    experiment: Experiment
    on_render: Callable[[int], None] = lambda frame: None
    device: str = "cpu"
    threads: int = 1

    def __post_init__(self) -> None:
        self.plugins, self.scene = PLUGINS, self.experiment.load_scene()
        self.log: list[Any] = []

    def open(self, run: TechniqueRun) -> tuple[FakeSession, Flat]:
        cls = self.plugins[run.name]
        return FakeSession(self.on_render, self.log, run.label), cls(cls.Params(**run.params))

    def reference(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        visibility = true_visibility(frame)
        return visibility, np.where(np.isnan(visibility), np.nan, 0.01).astype(np.float32)

    def ws_to_ss(self, frame: int) -> np.ndarray:
        return eye_view(camera(frame), WIDTH, HEIGHT, np.zeros(3)).ws_to_ss

    def map_use(self, session: FakeSession) -> MapUse | None:
        """Of a map whose texels are as many pixels wide as the frame's number, and one more; remembering reads none."""
        if session.label == "memory":
            return None
        image = np.full((HEIGHT, WIDTH), session.frame + 1.0, np.float32)
        number = np.zeros((HEIGHT, WIDTH), np.int32)
        return MapUse(SamplingRate(image, image, image, image, image, image, number, number), 0.25, 0.5)


def make_run(
    label: str, name: str = "flat", *, published: dict[str, float] | None = None, **params: Any
) -> TechniqueRun:
    return TechniqueRun(label, name, PLUGINS[name].Params(**params).model_dump(), published=published or {})


def make_experiment(
    runs: Sequence[TechniqueRun] | None = None,
    *,
    frames: Sequence[int] = range(5),
    every: int | None = 2,
    metrics: Sequence[str] = ("rmse", "flip"),
    repeats: int = 3,
) -> Experiment:
    runs = runs or (
        make_run("cheap", error=-0.2, ms=3.0),
        make_run("memory", "remembering", error=0.05, ms=5.0, own_error=True),
        make_run("slow [exact]", error=0.0, ms=9.0),
    )
    return Experiment(
        name="fake",
        scene={},
        image=Image(width=WIDTH, height=HEIGHT),
        reference=None if every is None else Reference(samples=64, every=every),
        metrics=tuple(metrics),
        projection=None,
        runs=tuple(runs),
        baseline=runs[0].label,
        repeats=repeats,
        seed=1,
        frames=tuple(frames),
        light=0,
        loaded_scene=make_scene(),
    )
