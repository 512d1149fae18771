"""What a technique is: a declared name, needs, parameters and limits, and one ``render``."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import warp as wp
from pydantic import BaseModel, ConfigDict, Field

from wkernels.frame.empty_maps import nothing_hides
from wkernels.frame.session import Session as Frame
from wkernels.light_maps.host_map import HostMap
from wkernels.light_maps.light_map import BIAS_CONSTANT, BIAS_NONE, BIAS_NORMAL, BIAS_SLOPE, Bias
from wkernels.raster import CULL_FRONT, CULL_NONE
from wkernels.raster.gbuffer import GBuffer
from wkernels.workspace.left_out import Omission
from wkernels.workspace.products import Product

ALL_LIGHTS = frozenset({"point", "directional", "rectangle", "disc", "sphere", "linear", "polygon"})

BiasKind = Literal["none", "constant", "slope", "back_face", "slope_back_face", "normal"]


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a scene must offer.

    Attributes:
        lights: Light kinds the technique is defined for.
        area: Whether the light must have an area (a point, or a sun without an angle, is refused).
        closed_meshes: Whether casters must be closed 2-manifolds.
        planar_receiver: Whether receivers must be planar.
        whole_casters: Whether casters must not be cut out by a texture.
        history: Whether results depend on earlier frames.
        still_light: Whether the light must stand still.
    """

    lights: frozenset[str] = ALL_LIGHTS
    area: bool = False
    closed_meshes: bool = False
    planar_receiver: bool = False
    whole_casters: bool = False
    history: bool = False
    still_light: bool = False


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A case in which the technique must give what another one gives.

    Attributes:
        equals: Name of the other technique.
        params: This technique's parameters in the limit.
        other_params: The other one's.
        light_scale: Factor on the light's size (0: the light shrinks to its centre).
        frames: Frames rendered of a still scene.
        tolerance: Largest difference of visibility away from shadow edges.
        flips: Share of pixels that may differ by more, along edges.
    """

    equals: str
    params: dict[str, Any] = field(default_factory=dict)
    other_params: dict[str, Any] = field(default_factory=dict)
    light_scale: float = 1.0
    frames: int = 1
    tolerance: float = 1e-5
    flips: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ExpectedFailure:
    """A conformance check that the published method cannot pass.

    Attributes:
        check: Name of the check.
        because: Why it cannot be passed.
        message: Regular expression that the failed assertion's text must match; any other failure is a defect.
    """

    check: str
    because: str
    message: str


class Params(BaseModel):
    """Base of all parameter models: unknown names are refused, numbers are finite, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def setting(default: Any, text: str, *, unit: str, source: str = "", **bounds: Any) -> Any:
    """A documented parameter.

    Args:
        default: Its only default anywhere.
        text: What it does, one line.
        unit: Its unit.
        source: Where the default comes from.
        **bounds: pydantic bounds (``ge``, ``le``, ``gt``, ``lt``).
    """
    return Field(default, description=text, json_schema_extra={"unit": unit, "source": source}, **bounds)


class MapParams(Params):
    """Parameters of every technique that reads a light depth map."""

    resolution: int = setting(1024, "map texels per side", unit="texels", source="Scherzer 2009, sec. 4", ge=1, le=8192)
    bias: BiasKind = setting(
        "slope", "what keeps a surface from shadowing itself", unit="kind", source="Stingl 2011, sec. 2.2.1"
    )
    bias_constant: float = setting(
        1.0, "constant bias (constant) or offset along the normal (normal)", unit="texel footprints", ge=0.0, le=1000.0
    )
    bias_slope: float = setting(
        1.1, "multiple of the least bias that one texel needs on the receiver's plane", unit="1", ge=0.0, le=1000.0
    )

    @property
    def device_bias(self) -> Bias:
        """The kernels' form of the bias parameters."""
        out = Bias()
        kinds = {"constant": BIAS_CONSTANT, "slope": BIAS_SLOPE, "slope_back_face": BIAS_SLOPE, "normal": BIAS_NORMAL}
        out.kind = kinds.get(self.bias, BIAS_NONE)
        out.constant, out.slope = self.bias_constant, self.bias_slope
        return out

    @property
    def cull(self) -> int:
        """Faces that the map leaves out: those turned to the light, for the back-face biases."""
        return CULL_FRONT if "back_face" in self.bias else CULL_NONE


class Technique(ABC):
    """A shadow technique; subclasses are final and live alone in their file.

    Attributes:
        name: File name = YAML key = id in results.
        family: Folder.
        paper: Keys in references.bib.
        needs: What a scene must offer.
        hard: Whether it shows the hard shadow of a soft light's centre; always so in the family ``hard``.
        bias_sign: Sign of the mean error by the method's nature: ``darker``, ``lighter`` or ``none``; seen, and not
            contradicted, in the conformance check's scenes.
        bias_turns: Where the sign is the opposite one, in words behind "where"; empty unless it is so by nature. Seen
            in the check's scene of a caster with a piece apart.
        limits: What it must equal in the limit; tested.
        expected_failures: Conformance checks that the published method cannot pass.
        products: What it pulls of a frame, with whatever parameters; tested.
        may_leave_out: What the technique itself leaves out where it is not needed, besides what every session does;
            ``explain`` tells it.
        stability_limits: Stiff cases (``kinds.stability``) in which the published method breaks by nature, each
            with its reason.
    """

    name: ClassVar[str]
    family: ClassVar[str]
    paper: ClassVar[tuple[str, ...]]
    needs: ClassVar[Needs] = Needs()
    hard: ClassVar[bool] = False
    bias_sign: ClassVar[Literal["darker", "lighter", "none"]]
    bias_turns: ClassVar[str] = ""
    limits: ClassVar[tuple[Limit, ...]] = ()
    expected_failures: ClassVar[tuple[ExpectedFailure, ...]] = ()
    products: ClassVar[tuple[Product, ...]] = ()
    may_leave_out: ClassVar[tuple[Omission, ...]] = ()
    stability_limits: ClassVar[dict[str, str]] = {}
    Params: ClassVar[type[Params]] = Params

    def __init__(self, params: Params | None = None) -> None:
        self.params: Any = params if params is not None else self.Params()

    @property
    def all_lights(self) -> bool:
        """Whether the visibility is that of all the scene's lights together, with these parameters.

        That is the mean of each light's visibility, weighted by radiance (``many_lights.light_weights``), and so is the
        reference that it is scored by. An experiment whose scene has several lights has techniques of one sort only.
        ``lights``, a parameter of techniques that can do either, says so unless overridden.
        """
        return getattr(self.params, "lights", "asked") != "asked"

    def leaves_out(self) -> tuple[Omission, ...]:
        """Those of ``may_leave_out`` that can happen with these parameters."""
        return self.may_leave_out

    @abstractmethod
    def render(self, frame: Frame) -> wp.array:
        """Visibility of the frame's receivers, float32, shape of the G-buffer that was asked for."""

    @classmethod
    def documentation(cls) -> str:
        """The docstring of the technique's file."""
        return (sys.modules[cls.__module__].__doc__ or "").strip()


class MapTechnique(Technique):
    """A technique that looks every receiver up in one light depth map, seen from the light's centre.

    G-buffer and map are pulled here, and scenes that need no map end here; the file says how a map becomes visibility.
    """

    products: ClassVar[tuple[Product, ...]] = (Product.G_BUFFER, Product.LIGHT_MAP)
    Params: ClassVar[type[Params]] = MapParams

    @abstractmethod
    def shade(self, frame: Frame, gbuffer: GBuffer, light_map: HostMap, visibility_out: wp.array) -> None:
        """Fills ``visibility_out``, float32 (H, W) as the G-buffer, with 1 where there is no receiver."""

    def render(self, frame: Frame) -> wp.array:
        gbuffer = frame.gbuffer()
        visibility = frame.visibility_buffer(gbuffer)
        if frame.nothing_casts(visibility):
            return visibility
        light_map = frame.light_map(self.params.resolution, cull=self.params.cull)
        if not nothing_hides(frame, gbuffer, light_map, visibility):
            self.shade(frame, gbuffer, light_map, visibility)
        return visibility
