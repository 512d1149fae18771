"""What the runner asks of a renderer, and the renderer itself behind that interface.

The interface is small so that the runner's own rules (order, timing, resuming, failures) are tested without rendering.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from algorithms.plugins import load_all
from algorithms.projections.composition import compose
from experiments.rendering.reference import ReferenceRenderer
from experiments.schema.needs import check_runs
from wkernels.analysis import sampling_rate
from wkernels.device.launch import default_threads
from wkernels.errors import InputError, nearest
from wkernels.frame.session import Session
from wkernels.scene.geometry import Geometry
from wkernels.scene.views import eye_view
from wkernels.temporal.shadow_buffer.many_lights import light_weights

if TYPE_CHECKING:
    from experiments.schema.experiment import Experiment
    from experiments.schema.models import Image
    from experiments.schema.techniques import TechniqueRun
    from wkernels.scene.model import Scene


class FrameLike(Protocol):
    """The part of ``wkernels.frame.session.FrameResult`` that is stored; see there."""

    visibility: np.ndarray
    color: np.ndarray
    standard_error: np.ndarray | None
    world_position: np.ndarray
    passes: list[tuple[str, float]]
    frame_ms: float
    shadow_ms: float
    left_out: list[tuple[str, str, int]]
    m_x_max: float
    m_z_max: float
    not_finite: int


class SessionLike(Protocol):
    """The part of ``wkernels.frame.session.Session`` that the runner drives; see there."""

    def begin(self, frame_index: int) -> None:
        """Moves to a frame; again with the same index it drops what was built for it."""

    def render(self, technique: Any) -> FrameLike:
        """Renders the frame."""

    def advance(self) -> None:
        """Commits history."""

    def reset(self) -> None:
        """Forgets history and products."""


class Engine(Protocol):
    """One experiment's renderer.

    Attributes:
        plugins: Technique classes by name, at least those of the experiment.
        scene: What is rendered.
        device: Warp device.
        threads: CPU threads, resolved.
    """

    plugins: Mapping[str, type]
    scene: Scene
    device: str
    threads: int

    def open(self, run: TechniqueRun) -> tuple[SessionLike, Any]:
        """A new session and the technique that it will render."""

    def reference(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Reference visibility and standard error of a frame, both (H, W), NaN where no receiver is seen."""

    def ws_to_ss(self, frame: int) -> np.ndarray:
        """The eye's matrix of a frame, float64 (4, 4), rows x, y, linear depth, w."""

    def map_use(self, session: Any) -> sampling_rate.MapUse | None:
        """How the light map that the session's last frame read suits it; None if it read none. Not timed."""


class WarpEngine:
    """Renders an experiment with Warp; all labels share one geometry.

    Args:
        experiment: The resolved experiment.
        device: ``cpu`` or a CUDA device.
        threads: CPU threads; None for all.
        skips: Whether work that the scene cannot need may be left out.
        plugins: Technique classes by name; None finds those of the installed packages.

    Raises:
        InputError: A technique is unknown or cannot work with the scene or light, or there is no such device.
    """

    def __init__(
        self,
        experiment: Experiment,
        *,
        device: str = "cpu",
        threads: int | None = None,
        skips: bool = True,
        plugins: Mapping[str, type] | None = None,
    ) -> None:
        plugins = load_all() if plugins is None else plugins
        check_device(device)
        self.experiment = experiment
        self.plugins = plugins
        self.scene = experiment.load_scene()
        self.device, self.skips = device, skips
        self.threads = default_threads() if threads is None else threads
        for run in experiment.runs:
            if run.name not in plugins:
                raise InputError(f"there is no technique '{run.name}'." + nearest(run.name, plugins))
        self.all_lights = check_runs(experiment.runs, plugins, self.scene, experiment.light)
        self._projections = {run.label: compose(run.projection) if run.projection else None for run in experiment.runs}
        self.geometry = Geometry(self.scene, device, self.threads)
        self._references: dict[int, ReferenceRenderer] = {}

    def open(
        self, run: TechniqueRun, *, skips: bool | None = None, done_anyway: Collection[tuple[str, str]] = ()
    ) -> tuple[Session, Any]:
        """A new session and the technique that it will render.

        Args:
            run: The technique.
            skips: Whether work may be left out; the engine's own choice if None.
            done_anyway: Pairs (what, reason) that are done nevertheless.
        """
        cls: Any = self.plugins[run.name]
        session = Session(
            self.geometry,
            width=self.experiment.image.width,
            height=self.experiment.image.height,
            light_index=self.experiment.light,
            device=self.device,
            threads=self.threads,
            seed=self.experiment.seed,
            projection=self._projections[run.label],
            skips=self.skips if skips is None else skips,
            done_anyway=done_anyway,
        )
        return session, cls(cls.Params(**run.params))

    def reference(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Reference visibility and standard error, from the cache where it has them.

        Where the techniques show all lights it is the mean of all lights' references, weighted as theirs is.
        """
        lights = self.scene.lights
        if not self.all_lights:
            return self._reference_of(self.experiment.light, frame)
        parts = [self._reference_of(index, frame) for index in range(len(lights))]
        weights = light_weights(lights)
        visibility = sum(w * v.astype(np.float64) for w, (v, _) in zip(weights, parts, strict=True))
        variance = sum((w * s.astype(np.float64)) ** 2 for w, (_, s) in zip(weights, parts, strict=True))
        return np.asarray(visibility, np.float32), np.asarray(np.sqrt(variance), np.float32)

    def _reference_of(self, light: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        experiment = self.experiment
        assert experiment.reference is not None
        if light not in self._references:
            self._references[light] = ReferenceRenderer(
                self.geometry,
                samples=experiment.reference.samples,
                width=experiment.image.width,
                height=experiment.image.height,
                light=light,
                centre=experiment.reference.light == "centre",
                device=self.device,
                threads=self.threads,
                # Not the techniques' samples: a method that shared them would share the error and look better.
                seed=experiment.seed + 1,
            )
        made = self._references[light].render(frame)
        return made.visibility, made.standard_error

    def ws_to_ss(self, frame: int) -> np.ndarray:
        """The eye's matrix of a frame in the scene's own world space."""
        image = self.experiment.image
        return eye_view(self.scene.camera(frame), image.width, image.height, np.zeros(3)).ws_to_ss

    def map_use(self, session: Any) -> sampling_rate.MapUse | None:
        """See ``wkernels.analysis.sampling_rate``."""
        return sampling_rate.map_use(session)


def check_result(result: FrameLike | None, image: Image) -> None:
    """Refuses what cannot be measured: metrics leave out pixels that are not finite, and would flatter a technique.

    Raises:
        ValueError: The result is not one number for every receiver pixel of the image.
    """
    assert result is not None
    size = (image.height, image.width)
    if result.visibility.shape != size:
        raise ValueError(f"visibility has the size {result.visibility.shape}, not {size}")
    receivers = int(np.isfinite(result.visibility).sum()) + result.not_finite
    if result.not_finite:
        raise ValueError(f"visibility is not finite in {result.not_finite} of {receivers} receiver pixels")
    if result.standard_error is not None:
        known = result.standard_error[np.isfinite(result.visibility)]
        if wrong := int((~(known >= 0.0) | np.isinf(known)).sum()):
            raise ValueError(f"the standard error is negative or not finite in {wrong} of {receivers} receiver pixels")


def check_device(device: str) -> None:
    """Raises InputError unless ``device`` names a Warp device of this machine."""
    known = [str(d) for d in wp.get_devices()]
    if device not in known and device != "cuda":
        raise InputError(f"there is no device '{device}'." + nearest(device, known), key="--device")
    if device == "cuda" and not wp.is_cuda_available():
        raise InputError("there is no CUDA device on this machine.", key="--device")


def kernels_of(technique: type) -> int:
    """How many kernels stand in a technique's own file."""
    return sum(
        isinstance(held, wp.Kernel) and held.module.name == technique.__module__
        for held in vars(sys.modules[technique.__module__]).values()
    )
