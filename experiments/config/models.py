"""Models of the experiment file, as it is written (DESIGN section 5)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from experiments.config.source import StrictModel

Pixels = Annotated[int, Field(ge=1, le=16384)]
WarpName = Literal["none", "psm", "lispsm_nopt", "lispsm_nrepar", "arbitrary"]
Scheme = Literal["uniform", "log", "practical", "pseudo"]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class Image(StrictModel):
    """Size of the rendered frames in pixels, 1 to 16384."""

    width: Pixels
    height: Pixels


class Reference(StrictModel):
    """The ray-cast reference.

    Attributes:
        samples: Light samples per pixel; one ray is exact for a light without area, and more are not cast.
        every: Made on every so many rendered frames.
        light: What is asked for: the visibility of the ``whole`` light, or that of its ``centre``, which is the picture
            that techniques for hard shadows are after: one ray, as ``ray_cast_point_shadow``.
    """

    samples: int = Field(256, ge=1, le=1_000_000)
    every: int = Field(1, ge=1)
    light: Literal["whole", "centre"] = "whole"

    @model_validator(mode="before")
    @classmethod
    def _one_sample(cls, data: Any) -> Any:
        """The default of the centre."""
        if isinstance(data, dict) and data.get("light") == "centre":
            return {"samples": 1, **data}
        return data

    @model_validator(mode="after")
    def _centre_is_one_sample(self) -> Reference:
        if self.light == "centre" and self.samples != 1:
            raise ValueError(f"asks for {self.samples} samples of the light's centre, which is one.")
        return self


class Projection(StrictModel):
    """How light views are laid over the scene; the default of every technique that reads a shadow map.

    Attributes:
        fit: What the light view is fitted to; a file of ``algorithms/projections/fits``.
        warp: Reparametrisation towards the eye.
        warp_distance: n' of the warp ``arbitrary``, as a multiple of what a split covers along the view.
        warp_centre: What a warp is centred on: the view vector, or the corner nearest to the eye, which jumps.
        splits: Number of depth splits of the view frustum, 1 to 16.
        scheme: How the splits are spaced.
        pseudo_near, pseudo_far: Shares of the depth range before and behind the planes that the scheme ``pseudo`` looks
            between; their sum is less than 1.
        lambda_: Key ``lambda``: 0 = uniform, 1 = logarithmic spacing of the ``practical`` scheme.
        selection: Which split a receiver reads.
        partition: Whether the view is divided by depth, into ``splits``, or by its side faces, up to four of them, each
            with a map and a warp of its own.
        near: The near plane that fit, splits and warp start from: the camera's (``user``), moved out to the nearest
            thing in sight (``auto``), or to what the last frame saw, which clips what has come nearer since
            (``auto_previous``).
        adjust: Whether the splits' range follows what is seen of the scene; without it splits may be empty.
        depth: ``scene``: casters keep their depth; ``tight``: those far before what is seen are clamped to a near plane
            there. No shadow is lost, but soft shadows take those casters for nearer than they are.
        storage: How the splits' maps are stored; never changes the picture.
        drawing: Each split's map in a pass of its own, or all in one over the triangles; never changes the picture.
        stabilise: Remedy against swimming shadow edges.
    """

    fit: str = "scene"
    warp: WarpName = "none"
    warp_distance: float | None = Field(None, gt=0.0)
    warp_centre: Literal["view_vector", "vertex"] = "view_vector"
    splits: int = Field(1, ge=1, le=16)
    scheme: Scheme = "practical"
    lambda_: Fraction = Field(0.5, alias="lambda")
    pseudo_near: Fraction = 0.0
    pseudo_far: Fraction = 0.0
    selection: Literal["depth", "best"] = "depth"
    partition: Literal["depth", "faces"] = "depth"
    near: Literal["user", "auto", "auto_previous"] = "user"
    adjust: bool = True
    depth: Literal["scene", "tight"] = "scene"
    storage: Literal["separate", "array", "cube6", "atlas4", "atlas9", "atlas16"] = "separate"
    drawing: Literal["passes", "cloned", "instanced"] = "passes"
    stabilise: Literal["none", "exact", "approximate"] = "none"


class FrameRange(StrictModel):
    """Frames ``start, start + step, ...`` below ``stop``."""

    start: int = Field(0, ge=0)
    stop: int = Field(ge=1)
    step: int = Field(1, ge=1)

    @model_validator(mode="after")
    def _not_empty(self) -> FrameRange:
        if self.stop <= self.start:
            raise ValueError(f"holds no frame: stop {self.stop} must be greater than start {self.start}.")
        return self

    def indices(self) -> tuple[int, ...]:
        """The frame numbers."""
        return tuple(range(self.start, self.stop, self.step))


class WalkthroughFile(StrictModel):
    """An experiment file of ``kind: walkthrough``; ``Experiment`` says what the keys mean."""

    kind: Literal["walkthrough"]
    scene: str | dict[str, Any]
    image: Image
    reference: Reference | None = None
    metrics: list[str] | None = None
    projection: Projection | None = None
    techniques: list[str | dict[str, Any]] = Field(min_length=1)
    baseline: str | None = None
    repeats: int = Field(1, ge=1, le=1000)
    seed: int = Field(1, ge=0, le=2**31 - 1)
    frames: Annotated[int, Field(ge=1)] | FrameRange | None = None
    light: int = Field(0, ge=0)
