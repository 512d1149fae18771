"""Parameters of every technique that keeps a shadow buffer: light samples, storage, moving objects."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import model_validator

from algorithms.technique import MapParams, setting

Movers = Literal["disocclude", "at_once", "gradual", "ignore"]


class ShadowBufferParams(MapParams):
    """What ``ShadowBufferTechnique`` reads."""

    sample_set: Literal["halton", "r2", "poisson_disc", "stratified", "random"] = setting(
        "halton", "point set on the light", unit="name", source="Scherzer 2009, sec. 4"
    )
    filter: bool = setting(
        True, "smooth what is shown while its error is large", unit="yes/no", source="Scherzer 2009, sec. 3.3"
    )
    filter_depth_range: float = setting(
        0.015,
        "largest depth difference of smoothed neighbours",
        unit="eye depths",
        source="Schwaerzler 2009, app. A",
        gt=0.0,
        le=1.0,
    )
    overscan: float = setting(
        0.05,
        "how much larger than the frame the shadow buffer is",
        unit="frame sizes",
        source="Scherzer 2009, sec. 4",
        ge=0.0,
        le=1.0,
    )
    turned_away: Literal["dark", "tested"] = setting(
        "dark",
        "casting surfaces that the whole light is behind: dark at once, with neither test nor history; published: "
        "tested",
        unit="name",
    )
    cap: bool = setting(
        True,
        "halve both sums before n leaves what the texel format counts exactly; published: no, which drifts in float16",
        unit="yes/no",
    )
    largest_n: float = setting(
        2.0**22,
        "largest n: an exponential window of so many tests, so that older ones leave; the default is no window. In "
        "float16 each frame then rounds both sums, which is too much above 64",
        unit="samples",
        ge=2.0,
        le=2.0**22,
    )
    agreement: float = setting(
        0.3,
        "the same per pixel: n of interpolated history is at most this multiple of psi (1 - psi) / variance of psi "
        "among its texels; 0: not limited, as published",
        unit="1",
        ge=0.0,
        le=1e6,
    )
    least_window: float = setting(4.0, "n to which agreement may limit history", unit="samples", ge=1.0, le=2.0**22)
    stop_error: float = setting(
        0.0,
        "standard error from which down nothing is drawn any more while eye, light and scene stand still; 0: never",
        unit="1",
        ge=0.0,
        le=1.0,
    )
    stop_samples: int = setting(
        256, "still frames before that, as few tests that agree promise too much", unit="frames", ge=2, le=2**22
    )
    kept_views: int = setting(
        1,
        "shadow buffers in which new points are looked for: the last frame's, as published, and of earlier views, 16 "
        "bytes a pixel each",
        unit="buffers",
        ge=1,
        le=4,
    )
    kept_overlap: float = setting(
        0.75,
        "a buffer is kept once less than this share of what it holds is still in view",
        unit="1",
        gt=0.0,
        le=1.0,
    )
    movers: Movers = setting(
        "disocclude",
        "shadows of moving casters: every frame starts anew and stores nothing; stored and dropped at once when they "
        "leave; faded out from there on; or treated as any other",
        unit="name",
        source="Scherzer 2009, sec. 3.4; Schwaerzler 2009, sec. 5.2.5, app. A",
    )
    mover_decrement: float = setting(
        1.0,
        "by how much n falls a frame where a mover's shadow fades out, the frame's own test counted",
        unit="samples",
        source="Schwaerzler 2009, eq. 5.16",
        gt=0.0,
        le=1e6,
    )
    mover_surfaces: Literal["camera", "own_motion"] = setting(
        "camera",
        "where surfaces that move look for their history: where the eye saw the place, or the point itself; "
        "published: camera",
        unit="name",
    )
    mover_samples: float = setting(
        16.0, "largest n on surfaces that are followed by their own motion", unit="samples", ge=1.0, le=1e6
    )
    mover_map: Literal["none", "centre"] = setting(
        "none",
        "a second map at the light's centre, of moving casters alone: soft shadows of it darken what still casters "
        "leave, whose history no mover touches; movers has no effect then",
        unit="name",
        source="Scherzer 2009, sec. 5",
    )
    mover_taps: int = setting(
        16, "taps of the blocker search and of the filter in that map", unit="taps", ge=1, le=4096
    )
    mover_overlap: Literal["product", "max"] = setting(
        "product",
        "what is hidden where both hide some: as if by chance, or as if one mask lay in the other",
        unit="name",
    )
    lights: Literal["asked", "drawn", "all"] = setting(
        "asked",
        "whose light: of the one that is asked for; of all, weighted by radiance, with a map of each in every frame; "
        "or of all, with one map a frame, each light's as often as it weighs",
        unit="name",
        source="Scherzer 2009, sec. 5",
    )
    ageing: Literal["none", "frames", "displacement", "balanced"] = setting(
        "balanced",
        "what is remembered loses weight in every frame in which the light moves: by age_factor; by exp(-displacement "
        "/ age_displacement); or so that lag and noise are about the same, a window of displacement^(-2/3) / 2 frames",
        unit="name",
        source="Scherzer 2009, sec. 5; Schwaerzler 2009, sec. 5.4.1",
    )
    age_factor: float = setting(
        0.9,
        "a: factor on rho and n before each test once 1 / (1 - a) are remembered; for ageing: frames",
        unit="1",
        source="own specification",
        ge=0.0,
        lt=1.0,
    )
    age_displacement: float = setting(
        0.2,
        "displacement of the light over which weights fall to 1/e; for ageing: displacement",
        unit="light sizes",
        gt=0.0,
        le=1e6,
    )

    @model_validator(mode="after")
    def _one_map_of_movers(self) -> Any:
        if self.lights != "asked" and self.mover_map != "none":
            raise ValueError("mover_map has a map of one light: it goes with lights: asked only")
        return self
