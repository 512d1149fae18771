"""The keys of a projection: one model for experiment files, Python calls and ``compose``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from algorithms.projections.table import fits, stabilisers, warps
from algorithms.technique import setting
from wkernels.errors import InputError, nearest
from wkernels.frame.near_plane import NEAR_PLANES
from wkernels.light_maps.storage import DRAWINGS, PLACES
from wkernels.projections.splits import SCHEMES


class OneOf:
    """Marks a name of a table, which is looked up whenever a value is checked: plugin files may have added to it."""

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        self.names = names

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"type": "string", "enum": list(self.names())}

    def _checked(self, name: Any) -> Any:
        known = list(self.names())
        if name not in known:  # the error of a Literal, so that it reads the same
            raise PydanticKnownError("literal_error", {"expected": " or ".join(map(repr, known))})
        return name


WarpName = Annotated[str, OneOf(warps)]
Scheme = Annotated[str, OneOf(lambda: SCHEMES)]
Splits = Annotated[int, Field(ge=1, le=16)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Distance = Annotated[float, Field(gt=0.0)]


PARTS = ("fit", "warp", "stabilise")
"""Keys that name files."""


class Projection(BaseModel):
    """How light views are laid over the scene, with the plainest values as defaults.

    What makes sense together is up to ``compose``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    fit: Annotated[str, OneOf(fits)] = setting("scene", "what the light view is fitted to", unit="name")
    warp: WarpName = setting("none", "reparametrisation of the map towards the eye", unit="name")
    warp_distance: Distance | None = setting(
        None, "n' of the warp `arbitrary`", unit="lengths that a split covers along the view"
    )
    warp_centre: Literal["view_vector", "vertex"] = setting(
        "view_vector", "what a warp is centred on: the view vector, or the corner nearest to the eye, which jumps",
        unit="kind",
    )  # fmt: skip
    splits: Splits = setting(1, "parts that the view is divided into by depth, each with a map of its own", unit="maps")
    scheme: Scheme = setting("practical", "how the splits are spaced", unit="kind", source="Stingl 2011, sec. 3.3.2")
    lambda_: Share = setting(
        0.5, "spacing of the scheme `practical`: 0 uniform, 1 logarithmic", unit="1", alias="lambda"
    )
    pseudo_near: Share = setting(
        0.0, "share of the depth range before the planes that the scheme `pseudo` looks between", unit="1"
    )
    pseudo_far: Share = setting(0.0, "share of the depth range behind them; both together are less than 1", unit="1")
    selection: Literal["depth", "best"] = setting(
        "depth", "which split a receiver reads: that of its depth, or the finest that holds it", unit="kind"
    )
    partition: Literal["depth", "faces"] = setting(
        "depth", "whether the view is divided by depth, or by its side faces with a map and a warp each", unit="kind"
    )
    near: Annotated[str, OneOf(lambda: NEAR_PLANES)] = setting(
        "user",
        "near plane that fit, splits and warp start from: the camera's, moved out to the nearest thing in sight, or "
        "to what the last frame saw, which clips what has come nearer since",
        unit="kind",
    )
    adjust: bool = setting(
        True, "whether the splits' range follows what is seen of the scene; otherwise some may be empty", unit="choice"
    )
    depth: Literal["scene", "tight"] = setting(
        "scene",
        "whether casters keep their depth, or those far before what is seen are clamped to a near plane there: no "
        "shadow is lost, but soft shadows take those casters for nearer than they are",
        unit="kind",
    )
    storage: Annotated[str, OneOf(lambda: PLACES)] = setting(
        "separate", "how the splits' maps are stored; never changes the picture", unit="kind"
    )
    drawing: Annotated[str, OneOf(lambda: DRAWINGS)] = setting(
        "passes",
        "each split's map in a pass of its own, or all in one over the triangles; never changes the picture",
        unit="kind",
    )
    stabilise: Annotated[str, OneOf(lambda: ("none", *stabilisers()))] = setting(
        "none", "remedy against swimming shadow edges", unit="name"
    )

    def written(self) -> dict[str, Any]:
        """The values by key, as an experiment file writes them."""
        return self.model_dump(by_alias=True)

    def changed(self) -> dict[str, Any]:
        """Those that are not at their defaults."""
        plain = Projection().written()
        return {key: value for key, value in self.written().items() if value != plain[key]}


def read_projection(settings: Mapping[str, Any]) -> Projection:
    """The projection that a mapping stands for.

    Raises:
        InputError: An unknown key, or a value that does not exist; names those that do.
    """
    try:
        return Projection.model_validate(dict(settings))
    except ValidationError as error:
        found = error.errors(include_url=False)
        first = next((item for item in found if item["type"] == "extra_forbidden"), found[0])
    key, keys = str(first["loc"][0]), Projection.model_json_schema()["properties"]
    if key not in keys:
        raise InputError(f"is not a known key.{nearest(key, keys)}", key=f"projection.{key}")
    available = _available(keys[key])
    raise InputError(f"{first['input']!r} is not available; available: {available}.", key=f"projection.{key}")


def _available(schema: Mapping[str, Any]) -> str:
    """What a key of the JSON schema accepts."""
    if "anyOf" in schema:
        return " or ".join(_available(part) for part in schema["anyOf"])
    if schema["type"] == "boolean":
        return "True, False"
    if "enum" in schema:
        return ", ".join(schema["enum"])
    if schema["type"] == "null":
        return "None"
    return f"{schema['minimum']:g} to {schema['maximum']:g}" if "maximum" in schema else "numbers above 0"
