"""The experiment file of ``kind: analysis``: perspective error curves from closed forms, without a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from algorithms.projections.schema import Distance, Projection, Scheme, Share, Splits, WarpName
from experiments.config.messages import Loc
from experiments.config.overrides import apply_overrides
from experiments.config.source import Source, StrictModel, dump_yaml, load_yaml, validate
from experiments.scenes.schema import NARROWEST, Positive
from experiments.schema.published import CURVE_QUANTITIES, check_published
from experiments.schema.techniques import check_projection


class AnalysisCamera(StrictModel):
    """The eye.

    Attributes:
        fov_deg: Vertical field of view.
        near, far: Depth range, scene units.
    """

    fov_deg: float = Field(ge=NARROWEST, lt=180.0)
    near: Positive
    far: Positive


_PLAIN = Projection()


class CurveFile(StrictModel):
    """One curve, as it is written; ``Curve`` says what the other keys mean.

    Attributes:
        splits: How many.
        scheme: How the depth range is split.
        lambda_: 0 = uniform, 1 = logarithmic; of the schemes ``practical`` and ``pseudo``.
    """

    label: str = Field(min_length=1, max_length=100)
    warp: WarpName = _PLAIN.warp
    warp_distance: Distance | None = _PLAIN.warp_distance
    splits: Splits = _PLAIN.splits
    scheme: Scheme = _PLAIN.scheme
    lambda_: Share = Field(_PLAIN.lambda_, alias="lambda")
    pseudo_near: Share = _PLAIN.pseudo_near
    pseudo_far: Share = _PLAIN.pseudo_far
    near: Positive | None = None
    far: Positive | None = None
    light_angle_deg: float | None = Field(None, ge=0.0, le=180.0)
    published: dict[str, float] | None = None


class AnalysisFile(StrictModel):
    """An experiment file of ``kind: analysis``.

    Attributes:
        camera: The eye.
        light_angle_deg: Angle between light and view direction; 90 = overhead.
        curves: Lines of the plot.
    """

    kind: Literal["analysis"]
    camera: AnalysisCamera
    light_angle_deg: float = Field(90.0, ge=0.0, le=180.0)
    curves: list[CurveFile] = Field(min_length=1, max_length=100)


@dataclass(frozen=True)
class Curve:
    """One line of the plot.

    Attributes:
        label: Unique name.
        warp, warp_distance: As in a projection.
        splits, scheme, blend: How the depth range is split; ``blend`` is the key ``lambda``.
        pseudo_near, pseudo_far: Shares of the depth range before and behind the pseudo planes.
        near, far: Depth range that the maps cover: the camera's, unless a focused map covers less.
        light_angle_deg: Angle between light and view direction; 90 = overhead.
        published: What the source printed, by name of ``experiments.schema.published.CURVE_QUANTITIES``.
    """

    label: str
    warp: str
    warp_distance: float | None
    splits: int
    scheme: str
    blend: float
    pseudo_near: float
    pseudo_far: float
    near: float
    far: float
    light_angle_deg: float
    published: dict[str, float] = field(default_factory=dict)

    def entry(self) -> dict[str, Any]:
        """The entry of an experiment file that gives this curve."""
        names = {"blend": "lambda"}
        return {names.get(key, key): value for key, value in vars(self).items() if value not in (None, {})}


@dataclass(frozen=True, eq=False)
class Analysis:
    """A resolved analysis.

    Attributes:
        name: Stem of the experiment file.
        fov_deg: Vertical field of view.
        curves: In file order.
    """

    name: str
    camera: AnalysisCamera
    light_angle_deg: float
    curves: tuple[Curve, ...]

    def to_yaml(self) -> str:
        """The analysis as a file that runs again and gives the same results."""
        return dump_yaml(
            {
                "kind": "analysis",
                "camera": self.camera.model_dump(),
                "light_angle_deg": self.light_angle_deg,
                "curves": [curve.entry() for curve in self.curves],
            }
        )


def load_analysis(path: str | Path, overrides: Iterable[str] = ()) -> Analysis:
    """Reads, checks and resolves an analysis.

    Raises:
        InputError: Something in the file or the overrides is wrong.
    """
    source = _read(path, overrides)
    file = validate(AnalysisFile, source)
    if file.camera.far <= file.camera.near:
        raise source.error("must be greater than near.", ("camera", "far"))
    curves: list[Curve] = []
    for i, written in enumerate(file.curves):
        curves.append(_curve(source, ("curves", i), written, file, [curve.label for curve in curves]))
    return Analysis(Path(path).stem, file.camera, file.light_angle_deg, tuple(curves))


def _read(path: str | Path, overrides: Iterable[str]) -> Source:
    source = load_yaml(Path(path))
    if not isinstance(source.data, dict):
        return source
    return apply_overrides(source, overrides)


def _curve(source: Source, loc: Loc, written: CurveFile, file: AnalysisFile, earlier: list[str]) -> Curve:
    if written.label in earlier:
        raise source.error(f"the label '{written.label}' is taken already.", (*loc, "label"))
    near = file.camera.near if written.near is None else written.near
    far = file.camera.far if written.far is None else written.far
    if not file.camera.near <= near < far <= file.camera.far:
        where = "far" if written.far is not None else "near"
        raise source.error(f"the range {near:g} to {far:g} must lie within the camera's, near first.", (*loc, where))
    drawn = written.model_dump(by_alias=True, exclude={"label", "near", "far", "light_angle_deg", "published"})
    check_projection(source, loc, {"fit": "focused", **drawn})
    return Curve(
        label=written.label,
        warp=written.warp,
        warp_distance=written.warp_distance,
        splits=written.splits,
        scheme=written.scheme,
        blend=written.lambda_,
        pseudo_near=written.pseudo_near,
        pseudo_far=written.pseudo_far,
        near=near,
        far=far,
        light_angle_deg=file.light_angle_deg if written.light_angle_deg is None else written.light_angle_deg,
        published=check_published(source, (*loc, "published"), written.published, CURVE_QUANTITIES),
    )
