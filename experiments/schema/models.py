"""Models of the experiment file, as it is written (docs/formats.md)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from algorithms.projections.schema import Projection
from experiments.config.source import StrictModel

Pixels = Annotated[int, Field(ge=1, le=16384)]


class Image(StrictModel):
    """Size of the rendered frames.

    Attributes:
        width: Pixels.
        height: Pixels.
    """

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


class FrameRange(StrictModel):
    """Frames ``start, start + step, ...`` below ``stop``.

    Attributes:
        start: The first.
        stop: The first that is not meant.
        step: From one to the next.
    """

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


Coordinate = Annotated[float, Field(ge=-1e12, le=1e12)]
Point = tuple[Coordinate, Coordinate, Coordinate]


RateMode = Literal["det", "x", "y"]


class ThirdPerson(StrictModel):
    """The free camera of ``views``: at a point, or around what the eye sees.

    Attributes:
        eye: Where it stands, scene units; None: at ``azimuth_deg``, ``elevation_deg`` and ``distance``.
        target: What it looks at; the middle of what the eye sees unless given.
        up: Its vertical axis; the eye's unless given.
        fov_deg: Vertical field of view.
        azimuth_deg: Where it stands about the vertical axis: 0 behind the eye, 90 to its right; default 60.
        elevation_deg: How high above the horizon; default 35.
        distance: 1, the default, where all that the eye sees just fills the picture; 2 twice as far away.
    """

    eye: Point | None = None
    target: Point | None = None
    up: Point | None = None
    fov_deg: float = Field(50.0, gt=0.0, lt=180.0)
    azimuth_deg: float | None = Field(None, ge=-360.0, le=360.0)
    elevation_deg: float | None = Field(None, gt=-90.0, lt=90.0)
    distance: float | None = Field(None, gt=0.0, le=1e6)

    @model_validator(mode="after")
    def _one_place(self) -> ThirdPerson:
        around = [key for key in ("azimuth_deg", "elevation_deg", "distance") if getattr(self, key) is not None]
        if self.eye is not None and around:
            raise ValueError(f"has an eye already; {around[0]} would place it again.")
        if self.eye is not None and self.eye == self.target:
            raise ValueError("eye and target must not be the same point.")
        if self.up is not None and not any(self.up):
            raise ValueError("up must not be the zero vector.")
        return self


def _area_only() -> list[RateMode]:
    return ["det"]


class Views(StrictModel):
    """Pictures that show why a technique fails (Stingl 2011, chapter 5), outside all timing.

    Attributes:
        frames: Rendered frames to picture; the first one unless given.
        kinds: Which pictures, names of ``experiments.schema.view_kinds``; ``all`` by default.
        labels: Of which techniques; all that read a light map unless given.
        third_person: Where the free camera stands.
        image: Size of the free camera's pictures, the frame's unless given; the eye's pictures are the frame itself.
        modes: What ``sampling_frequency`` shows: the root of the area ratio, the map's x or its y direction.
        texels: Texels per cell of the grid of ``texel_borders``; a power of two that can be seen unless given.
    """

    frames: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=1)] | FrameRange | None = None
    kinds: str | Annotated[list[str], Field(min_length=1)] = "all"
    labels: Annotated[list[str], Field(min_length=1)] | None = None
    third_person: ThirdPerson = Field(default_factory=lambda: ThirdPerson.model_validate({}))
    image: Image | None = None
    modes: Annotated[list[RateMode], Field(min_length=1)] = Field(default_factory=_area_only)
    texels: int | None = Field(None, ge=1, le=8192)


class RunFile(StrictModel):
    """What walkthroughs and sweeps have in common; ``Experiment`` says what the other keys mean.

    Attributes:
        reference: The ray-cast reference; without it no errors are known.
        metrics: Names of metrics; those that are computed always need none. ``sampling`` stands for those of the map.
        projection: Default of all techniques that read a light map; without it each has its own, ``fit: scene``.
        baseline: The label that costs are relative to; the first one unless given.
        frames: How many, or which; all of the scene's path unless given.
        views: Pictures that show why a technique fails.
    """

    image: Image
    reference: Reference | None = None
    metrics: list[str] | None = None
    projection: Projection | None = None
    baseline: str | None = None
    repeats: int = Field(1, ge=1, le=1000)
    seed: int = Field(1, ge=0, le=2**31 - 1)
    frames: Annotated[int, Field(ge=1)] | FrameRange | None = None
    lead_in: int = Field(0, ge=0, le=100_000)
    light: int = Field(0, ge=0)
    views: Views | None = None
