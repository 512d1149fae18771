"""What a scene file that imports another program's file may say (docs/formats.md), as a pydantic model."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from experiments.config.source import StrictModel
from experiments.scenes.schema import Name, PathOptions, Positive


class ImportingSceneFile(StrictModel):
    """The top level of a scene that imports another program's file.

    Attributes:
        import_file: A glTF (.glb, .gltf), USD (.usd, .usda, .usdc, .usdz) or Mitsuba 3 (.xml) file; its meshes, lights,
            cameras and animation come in.
        meshes: Meshes besides those of the file.
        lights: `from_file`, or a list of lights in place of the file's; an item `from_file` stands for all of these.
        camera: `from_file`: the first of the file's cameras; the name of another one; or the keys of a
            [camera](#camera), which replace those of the file's first.
        path: A path in place of the file's camera's.
        light_size: Diameter of the sphere that stands for a point light of the file.
        light_angle_deg: Angular diameter of the file's directional lights that have none.
        fps: Frames per second of the file's animation; as many as the file says, or 24, unless given.
        animation: Which of several animations, by name; the first unless given, `none` for none.
    """

    import_file: Annotated[Name, Field(alias="import")]
    meshes: list[Any] = Field(default_factory=list)
    lights: Literal["from_file"] | list[Any] = "from_file"
    camera: str | dict[str, Any] = "from_file"
    path: PathOptions | None = None
    light_size: Positive | None = None
    light_angle_deg: Annotated[float, Field(gt=0, lt=180)] | None = None
    fps: Annotated[float, Field(gt=0, le=100_000)] | None = None
    animation: Name | None = None
